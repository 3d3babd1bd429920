"""How often the index names the food, how honest its probabilities are, how it learns, how long it takes.

    python benchmarks/identification.py [--seeds 5] [--every 1] [--data FOLDER]

1. Specimens held out by number (never one specimen on both sides), from the shipped index's own vectors: top-1, top-5
   (targets: 92 %, 99 %), expected calibration error (target: 0.05). The temperature that is judged was fitted to the
   other folds alone. A food of one specimen cannot be known when that is held out: the figures are told with and
   without it.
2. Classes held out: how probable "none of these" is for what the index does not know, and what would be taken
   for granted wrongly.
3. Learning: a class left out of the index, confirmed one specimen's picture after another: how often it is first, among
   the first three, the first five for a picture of another specimen; by its looks alone, and for the person who
   confirmed those at that time of day.
4. Disturbed light, with the photographs at hand (FOLDER/photos/ecustfd): white balance and exposure off.
5. Without a box, with the photographs at hand.
6. Plates with two foods, with the photographs at hand: none of these photographs is in the index, though pieces on them
   may be in it from photographs of their own.
7. Processor time of one region, from decoded pixels to candidates, on one thread, against decoding its photograph.

FOLDER (default: TADA_SHARED_DATA, or ../shared); without it 4 to 7 are left out.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.identification.build_index import (  # noqa: E402
    fit_calibration,
    scores_of_unseen_classes,
    scores_of_unseen_specimens,
    specimen_folds,
)
from app.identification.food_index import FoodIndex, shipped_index  # noqa: E402
from app.identification.habits import Eaten, log_prior  # noqa: E402
from app.identification.identifier import Identifier  # noqa: E402
from app.identification.kernel_classifier import (  # noqa: E402  # found from the checkout, installed or not
    NONE_PRIOR,
    KernelClassifier,
    fit_classifier,
    posterior,
)
from app.vision.looks.food_boxes import propose_boxes  # noqa: E402
from app.vision.looks.vcm import describe  # noqa: E402
from app.vision.looks.vcm_region import region_of_box  # noqa: E402
from benchmarks.calibration_error import expected_calibration_error  # noqa: E402
from tools.food_index import LabelledFood, boxes_of, labelled_foods  # noqa: E402

LUNCH = 750  # minutes after midnight
TAKEN = 0.8  # the probability from which a food is proposed without being asked about
STUDY_NONE_PRIOR = 0.3  # that a study begins with (habits.py)
WHITE_BALANCES = {
    "as taken": (1.0, 1.0, 1.0),
    "bluish": (1.12, 1.0, 0.9),
    "yellowish": (0.85, 1.0, 1.12),
}
EXPOSURES = {"darker by a third": 2 / 3, "brighter by a fifth": 1.2}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=5, help="ways to deal the specimens out")
    parser.add_argument(
        "--every", type=int, default=1, help="take every so manieth photograph in 4 to 6"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    index = shipped_index()
    examples = index.metric.embed(index.vectors)
    print(
        f"index {index.version}: {len(examples)} regions of {len(set(index.specimens))} specimens\n"
    )
    print_held_out(index, examples, options.seeds)
    print_unknown(index, examples)
    print_learning(index)
    folder = options.data / "photos" / "ecustfd"
    foods = list(labelled_foods(folder))[:: options.every] if folder.exists() else []
    if not foods:
        print(
            "\nThere are no photographs: give --data FOLDER or set TADA_SHARED_DATA for the rest.",
            file=sys.stderr,
        )
        return 0
    judges = Judges(index, examples)
    print_light(judges, foods)
    print_without_box(judges, foods)
    print_mixed(index, folder)
    print_time(foods)
    return 0


def print_held_out(index: FoodIndex, examples: np.ndarray, seeds: int) -> None:
    rows = []
    for seed in range(seeds):
        scores, has_another = scores_of_unseen_specimens(
            examples, index.labels, index.specimens, len(index.foods), seed
        )
        chances = honest_probabilities(index, examples, scores, has_another, seed)
        best = np.argsort(-chances, axis=1)
        first = best[:, 0] == index.labels
        five = (best[:, :5] == index.labels[:, None]).any(axis=1)
        error = expected_calibration_error(chances.max(axis=1), first)
        rows.append(
            (first.mean(), five.mean(), error, first[has_another].mean(), five[has_another].mean())
        )
        if seed == 0:
            print_classes(index, best)
    mean, worst = np.mean(rows, axis=0), np.array(rows)
    print("specimens held out          top-1   top-5     ECE")
    print(f"all foods                 {mean[0]:7.1%} {mean[1]:7.1%} {mean[2]:7.3f}")
    print(f"without foods of one      {mean[3]:7.1%} {mean[4]:7.1%}")
    print(
        f"the worst of {seeds} dealings   {worst[:, 0].min():7.1%} {worst[:, 1].min():7.1%} {worst[:, 2].max():7.3f}\n"
    )


def honest_probabilities(
    index: FoodIndex, examples: np.ndarray, scores: np.ndarray, has_another: np.ndarray, seed: int
) -> np.ndarray:
    """Each fold's probabilities by a temperature that saw none of it."""
    unknown = scores_of_unseen_classes(examples, index.labels, len(index.foods))
    chances = np.zeros_like(scores)
    for held in specimen_folds(index.labels, index.specimens, seed=seed):
        others = np.setdiff1d(np.flatnonzero(has_another), held)
        calibration = fit_calibration(
            scores[others], index.labels[others], unknown[np.setdiff1d(others, held)]
        )
        chances[held], _ = posterior(
            *calibration.log_likelihoods(scores[held]), equal(len(index.foods))
        )
    return chances


def print_classes(index: FoodIndex, best: np.ndarray) -> None:
    print(f"{'food':<20}{'regions':>8}{'top-1':>8}{'top-5':>8}  taken for")
    for place, food in enumerate(index.foods):
        rows = index.labels == place
        wrong = [index.foods[i].label for i in best[rows, 0] if i != place]
        told = ", ".join(f"{label} {wrong.count(label)}" for label in dict.fromkeys(wrong))
        five = (best[rows, :5] == place).any(axis=1).mean()
        print(
            f"{food.label:<20}{rows.sum():>8}{(best[rows, 0] == place).mean():>8.0%}{five:>8.0%}  {told}"
        )
    print()


def print_unknown(index: FoodIndex, examples: np.ndarray) -> None:
    unknown = scores_of_unseen_classes(examples, index.labels, len(index.foods))
    known, has_another = scores_of_unseen_specimens(
        examples, index.labels, index.specimens, len(index.foods)
    )
    print(
        f"prior of none   none: known  unknown   taken at {TAKEN}: known  of these wrong  unknown"
    )
    for prior in (NONE_PRIOR, STUDY_NONE_PRIOR):
        of_known, none_known = posterior(
            *index.calibration.log_likelihoods(known), equal(len(index.foods)), prior
        )
        of_unknown, none_unknown = posterior(
            *index.calibration.log_likelihoods(unknown), equal(len(index.foods) - 1), prior
        )
        is_taken = (of_known.max(axis=1) >= TAKEN) & has_another
        wrong = (of_known.argmax(axis=1) != index.labels)[is_taken].mean()
        print(
            f"{prior:<16.2f}{none_known[has_another].mean():>10.0%}{none_unknown.mean():>9.0%}"
            f"{is_taken.sum() / has_another.sum():>22.0%}{wrong:>16.1%}"
            f"{(of_unknown.max(axis=1) >= TAKEN).mean():>9.0%}"
        )
    print()


def print_learning(index: FoodIndex) -> None:
    """Of each class in turn: left out, then its specimens' pictures confirmed one by one, in the order of numbers."""
    examples = index.metric.embed(index.vectors)
    specimens = np.array(index.specimens)
    names = [food.food_key for food in index.foods]
    ranks: dict[int, list[tuple[int, int]]] = {count: [] for count in (1, 2, 3, 5, 8)}
    for place in range(len(index.foods)):
        others = np.flatnonzero(index.labels != place)
        own = np.flatnonzero(index.labels == place)
        for name in np.unique(specimens[own]):
            asked = own[specimens[own] == name]
            pool = own[specimens[own] != name]
            _, firsts = np.unique(
                specimens[pool], return_index=True
            )  # a picture of each other specimen, then the rest
            order = [*pool[np.sort(firsts)], *np.delete(pool, firsts)]
            for count, found in ranks.items():
                if len(order) < count:
                    continue
                rows = np.concatenate([others, order[:count]]).astype(np.intp)
                scores = fit_classifier(
                    examples[rows], index.labels[rows], len(index.foods)
                ).scores(examples[asked])
                looks, _ = index.calibration.log_likelihoods(scores)
                eaten = [Eaten(names[place], LUNCH)] * count
                likely = looks + np.array(
                    log_prior(names, LUNCH, eaten, [])
                )  # nobody else has eaten anything
                found += [
                    (int((by_looks > by_looks[place]).sum()), int((by_both > by_both[place]).sum()))
                    for by_looks, by_both in zip(looks, likely, strict=True)
                ]
    print("a new food, confirmed   by looks alone:                by looks and habit:")
    print("                        first   first 3   first 5      first   first 3   first 5")
    for count, found in ranks.items():
        at = np.array(found)
        shares = [np.mean(at[:, way] < most) for way in (0, 1) for most in (1, 3, 5)]
        print(
            f"{count:>3} times          {shares[0]:>10.0%}{shares[1]:>10.0%}{shares[2]:>10.0%}"
            f"{shares[3]:>11.0%}{shares[4]:>10.0%}{shares[5]:>10.0%}"
        )


class Judges:
    """For each photograph a classifier that has not seen its specimen."""

    def __init__(self, index: FoodIndex, examples: np.ndarray) -> None:
        self.index = index
        self._by_specimen: dict[str, KernelClassifier] = {}
        everything = np.arange(len(examples))
        for held in specimen_folds(index.labels, index.specimens):
            kept = np.setdiff1d(everything, held)
            judge = fit_classifier(examples[kept], index.labels[kept], len(index.foods))
            self._by_specimen |= dict.fromkeys((index.specimens[i] for i in held), judge)

    def chances(
        self, food: LabelledFood, regions: Sequence[np.ndarray], prior: float
    ) -> np.ndarray:
        vectors = np.stack(regions).astype(np.float16).astype(np.float64)
        scores = self._by_specimen[food.specimen].scores(self.index.metric.embed(vectors))
        return posterior(
            *self.index.calibration.log_likelihoods(scores), equal(len(self.index.foods)), prior
        )[0]


def print_light(judges: Judges, foods: Sequence[LabelledFood]) -> None:
    lights: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        name: (lambda pixels, gains=gains: disturbed(pixels, gains))
        for name, gains in WHITE_BALANCES.items()
    }
    lights |= {
        name: (lambda pixels, by=by: disturbed(pixels, (by, by, by)))
        for name, by in EXPOSURES.items()
    }
    print("\nlight                     top-1   top-5")
    for name, change in lights.items():
        first = five = 0
        for food in foods:
            region = region_of_box(change(read(food)), food.box)
            best = np.argsort(-judges.chances(food, [describe(region)], NONE_PRIOR)[0])
            labels = [judges.index.foods[i].label for i in best]
            first, five = first + (labels[0] == food.label), five + (food.label in labels[:5])
        print(f"{name:<22}{first / len(foods):>9.1%}{five / len(foods):>8.1%}")


def print_without_box(judges: Judges, foods: Sequence[LabelledFood]) -> None:
    right = 0
    for food in foods:
        pixels = read(food)
        regions = [region_of_box(pixels, box) for box in propose_boxes(pixels)]
        chances = judges.chances(
            food, [describe(region) for region in regions if region is not None], 0.5
        )
        right += (
            judges.index.foods[int(chances[chances.max(axis=1).argmax()].argmax())].label
            == food.label
        )
    print(f"\nwithout a box: top-1 {right / len(foods):.1%} of {len(foods)}")


def print_mixed(index: FoodIndex, folder: Path) -> None:
    identifier = Identifier(index, none_prior=NONE_PRIOR)
    labels = {food.label for food in index.foods}
    chances, ranks = [], []
    for path in sorted((folder / "images").glob("mix*.jpg")):
        pixels = np.asarray(cv2.imread(str(path)))
        for label, box in boxes_of(path, folder / "boxes" / f"{path.stem}.xml"):
            region = region_of_box(pixels, box) if label in labels else None
            if region is None:
                continue
            ranked = identifier.identify(
                describe(region).astype(np.float64), most=len(labels)
            ).candidates
            chances.append(ranked[0].probability)
            ranks.append([one.label for one in ranked].index(label))
    at = np.array(ranks)
    error = expected_calibration_error(np.array(chances), at == 0)
    named = f"top-1 {np.mean(at < 1):.1%}, top-5 {np.mean(at < 5):.1%}"
    print(f"\ntwo foods on a plate: {named}, ECE {error:.3f} of {len(at)} regions")


def print_time(foods: Sequence[LabelledFood]) -> None:
    identifier = Identifier(shipped_index())
    whole, cutting, describing, naming, decoding = [], [], [], [], []
    for food in foods[:: max(1, len(foods) // 100)]:
        data = np.frombuffer(food.photo.read_bytes(), np.uint8)
        started = time.process_time()
        pixels = cv2.imdecode(data, cv2.IMREAD_COLOR)
        decoded = time.process_time()
        region = region_of_box(pixels, food.box)
        cut = time.process_time()
        vector = describe(region).astype(np.float64)
        described = time.process_time()
        identifier.identify(vector)
        done = time.process_time()
        for times, span in (
            (decoding, decoded - started),
            (cutting, cut - decoded),
            (describing, described - cut),
            (naming, done - described),
            (whole, done - decoded),
        ):
            times.append(1e3 * span)
    print("\none region, ms, median    (target: 30 ms)")
    for name, times in (
        ("cut out of its box", cutting),
        ("described", describing),
        ("named", naming),
        ("whole", whole),
    ):
        print(f"{name:<24}{statistics.median(times):>7.1f}   slowest {max(times):.1f}")
    ratio = statistics.median(whole) / statistics.median(decoding)
    print(
        f"{'decoding the photograph':<24}{statistics.median(decoding):>7.1f}   the whole is {ratio:.1f} times that"
    )


def disturbed(pixels_bgr: np.ndarray, gains: Sequence[float]) -> np.ndarray:
    """Light of other colour or strength: gains of B, G, R in linear light."""
    share = pixels_bgr / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear * np.array(gains), 0.0, 1.0)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * coded).astype(np.uint8)


def read(food: LabelledFood) -> np.ndarray:
    return np.asarray(cv2.imread(str(food.photo)))


def equal(classes: int) -> np.ndarray:
    return np.full(classes, -np.log(classes))


if __name__ == "__main__":
    raise SystemExit(main())
