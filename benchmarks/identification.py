"""How often the index names the food, how honest its probabilities are, how it learns, how long it takes.

    python benchmarks/identification.py [--every 1] [--data FOLDER]

With and without each half of the vector (learned features, VCM), food alone, by specimen, never one on both sides:

1. ECUSTFD's specimens, held out of the index of all foods: first, five, calibration error (targets: 95 %, 99 %, 0.03);
   of these assigned without asking, and of these wrong (85 %, 0.5 %); of foods that the index does not know (3 %).
   Assigned is what reaches the probability and the number of specimens of app/candidates; else a group of foods may be.
2. Fruit and vegetables of shops: photographs held out of the index of all foods (82 %, 96 %); dishes: servings.
3. Dishes: one photograph of each serving indexed, another one asked (90 %, 97 %); no second serving is at hand.
4. One and three photographs of each of ECUSTFD's foods, nothing else known (three: 88 %).
5. A food that the index of all others does not have, confirmed one to eight times: how often it is first, and among
   the first three, by its looks alone, and for the person who confirmed it at that time of day (once: 60 %, 86 %).

And of the index that ships:

6. Disturbed light: white balance and exposure off.
7. Without a box: ECUSTFD, whose foods lie on plates, and shops, whose foods fill the picture (75 %, 92 %).
8. Plates with two foods: none of these photographs is in the index, though pieces on them may be.
9. Processor time of one region, from decoded pixels to candidates, on one thread.

FOLDER (default: TADA_SHARED_DATA, or ../shared) has the photographs.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.candidates.food_groups import groups_of_foods  # noqa: E402
from app.candidates.identify_photo import UNPOINTED_NONE_PRIOR, identify_unpointed  # noqa: E402
from app.candidates.labelled_folder import labelled_photos  # noqa: E402
from app.identification.build_index import (  # noqa: E402
    fit_calibration,
    scores_of_unseen_classes,
    scores_of_unseen_specimens,
)
from app.identification.examples import NumberedIndex  # noqa: E402
from app.identification.food_index import FoodIndex, shipped_index  # noqa: E402
from app.identification.groups import group_probabilities  # noqa: E402
from app.identification.habits import NEW_FOODS, NEW_OF, log_prior  # noqa: E402
from app.identification.identifier import Identifier  # noqa: E402
from app.identification.kernel_classifier import (  # noqa: E402  # found from the checkout, installed or not
    NONE_PRIOR,
    Calibration,
    KernelClassifier,
    posterior,
)
from app.meals.stored.run_answer import (  # noqa: E402
    FEWEST_SPECIMENS,
    GROUP_SURE_FROM,
    SURE_FROM,
)
from app.vision.looks.vcm import describe  # noqa: E402
from app.vision.looks.vcm_region import region_of_box  # noqa: E402
from benchmarks.calibration_error import expected_calibration_error  # noqa: E402
from tools.food_index import (  # noqa: E402
    DISHES,
    ECUSTFD,
    GROCERY,
    LABELS,
    DescribedFood,
    LabelledFood,
    boxes_of,
    described_foods,
    labelled_foods,
    read_labels_of_sources,
)
from tools.food_metric import LAYOUT, fit_metric  # noqa: E402

STUDY_NONE_PRIOR = NEW_FOODS / NEW_OF  # that a study begins with
EPISODES = 15  # ways to choose one or three photographs of each food
WHITE_BALANCES = {
    "as taken": (1.0, 1.0, 1.0),
    "bluish": (1.12, 1.0, 0.9),
    "yellowish": (0.85, 1.0, 1.12),
}
EXPOSURES = {"darker by a third": 2 / 3, "brighter by a fifth": 1.2}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--every", type=int, default=1, help="take every so manieth photograph in 6 to 8"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    photos = options.data / "photos"
    if not (photos / ECUSTFD).exists():
        print(
            "There are no photographs: give --data FOLDER or set TADA_SHARED_DATA.", file=sys.stderr
        )
        return 1
    shown = list(described_foods(photos))
    for name, blocks in (
        ("VCM and learned features", slice(None)),
        ("VCM alone", slice(0, -1)),
        ("learned features alone", slice(-1, None)),
    ):
        print(f"{name}\n{'-' * len(name)}")
        regions = Regions.of(shown, blocks)
        print_held_out(regions)
        print_dishes(regions)
        print_few(regions)
        print_learning(regions)
        print()
    print(f"the index that ships: {shipped_index().version}")
    key_of = read_labels_of_sources(LABELS)
    foods = list(labelled_foods(photos / ECUSTFD))[:: options.every]
    print_light(foods, key_of)
    print_without_box(photos, options.every, key_of)
    print_mixed(photos / ECUSTFD, key_of)
    print_time(foods)
    return 0


@dataclass(frozen=True, slots=True)
class Regions:
    """All regions of all photographs, embedded by a metric that was fitted to them.

    labels: (n,) places in keys. photos: (n,) numbers of their photographs.
    """

    examples: np.ndarray
    labels: np.ndarray
    keys: Sequence[str]
    specimens: np.ndarray
    sources: np.ndarray
    photos: np.ndarray

    @classmethod
    def of(cls, shown: Sequence[DescribedFood], blocks: slice) -> "Regions":
        """blocks: of the vector, that count; each keeps its share of what all of them have."""
        keys = sorted({food.key for food in shown})
        counts = [len(food.views) for food in shown]
        begin = sum(block.size for block in LAYOUT[: blocks.indices(len(LAYOUT))[0]])
        layout = LAYOUT[blocks]
        size, share = sum(block.size for block in layout), sum(block.share for block in layout)
        vectors = np.concatenate([food.views for food in shown])[:, begin : begin + size]
        metric = fit_metric(
            vectors, [replace(block, share=block.share / share) for block in layout]
        )
        return cls(
            examples=metric.embed(vectors),
            labels=np.repeat([keys.index(food.key) for food in shown], counts),
            keys=keys,
            specimens=np.repeat([food.specimen for food in shown], counts),
            sources=np.repeat([food.source for food in shown], counts),
            photos=np.repeat(np.arange(len(shown)), counts),
        )

    def classifier(self, rows: np.ndarray) -> KernelClassifier:
        return KernelClassifier(self.examples[rows], self.labels[rows], len(self.keys))

    def of_photos(self, rows: np.ndarray, scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean scores of each photograph's views, and its label."""
        _, first, place = np.unique(self.photos[rows], return_index=True, return_inverse=True)
        sums = np.zeros((len(first), scores.shape[1]))
        np.add.at(sums, place, scores)
        return sums / np.bincount(place)[:, None], self.labels[rows[first]]


def print_held_out(regions: Regions) -> None:
    """1 and 2: each specimen held out of all foods; each food held out whole, as one that is not known."""
    known, has_another = scores_of_unseen_specimens(
        regions.examples, regions.labels, regions.specimens.tolist(), len(regions.keys)
    )
    unknown = scores_of_unseen_classes(regions.examples, regions.labels, len(regions.keys))
    calibration = fit_calibration(known[has_another], regions.labels[has_another], unknown)
    print(
        "                                              assigned to a food,   a group,     unknown ones to"
    )
    print(
        "held out    photographs   first    five     ECE   of these wrong   wrong      a food   a wrong group"
    )
    for source in (ECUSTFD, GROCERY, DISHES):
        rows = np.flatnonzero((regions.sources == source) & has_another)
        scores, labels = regions.of_photos(rows, known[rows])
        chances, _ = posterior(*calibration.log_likelihoods(scores), equal(len(regions.keys)))
        first, five = ranks(chances, labels) < 1, ranks(chances, labels) < 5
        error = expected_calibration_error(chances.max(axis=1), first)
        food, group, is_wrong, is_wrong_group = assigned(regions, calibration, scores, labels)
        rows = np.flatnonzero(regions.sources == source)
        scores, others = regions.of_photos(rows, unknown[rows])
        is_other = np.arange(len(regions.keys)) != others[:, None]
        of_others = np.zeros(is_other.shape)  # an own food that is not known scores nothing
        of_others[is_other] = scores.ravel()
        taken, _, _, is_wrong_taken = assigned(regions, calibration, of_others, others)
        print(
            f"{source:<11}{len(labels):>12}{first.mean():>8.1%}{five.mean():>8.1%}{error:>8.3f}"
            f"{food.mean():>8.1%}{is_wrong[food].mean():>9.2%}"
            f"{group.mean():>10.1%}{is_wrong_group[group].mean():>8.1%}"
            f"{taken.mean():>12.1%}{is_wrong_taken.mean():>12.1%}"
        )


def assigned(
    regions: Regions, calibration: Calibration, scores: np.ndarray, labels: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(n,) whether to a food, to a group; whether the likeliest food is wrong; whether assigned to a wrong group."""
    pieces = np.array(
        [
            len(set(regions.specimens[regions.labels == label].tolist()))
            for label in range(len(regions.keys))
        ]
    )
    groups = {
        key: own
        for key, members in groups_of_foods().items()
        if (own := np.array([food in members for food in regions.keys])).sum() > 1
    }
    prior = equal(len(regions.keys))
    chances, _ = posterior(*calibration.log_likelihoods(scores), prior, STUDY_NONE_PRIOR)
    best = chances.argmax(axis=1)
    to_food = (chances.max(axis=1) >= SURE_FROM) & (pieces[best] >= FEWEST_SPECIMENS)
    to_group, is_wrong_group = np.zeros(len(labels), np.bool_), np.zeros(len(labels), np.bool_)
    for row in np.flatnonzero(chances.max(axis=1) < SURE_FROM):
        found = group_probabilities(scores[row], prior, groups, calibration, STUDY_NONE_PRIOR)
        key = max(found, key=lambda each: found[each])
        to_group[row] = found[key] >= GROUP_SURE_FROM
        is_wrong_group[row] = to_group[row] and not groups[key][labels[row]]
    return to_food, to_group, best != labels, is_wrong_group


def print_dishes(regions: Regions) -> None:
    """3: the first photograph of each folder is indexed, the others are asked."""
    rows = np.flatnonzero(regions.sources == DISHES)
    folders, place = np.unique(regions.specimens[rows], return_inverse=True)
    firsts = np.array(
        [regions.photos[rows[place == number]].min() for number in range(len(folders))]
    )
    is_first = regions.photos[rows] == firsts[place]
    of_folders = replace(regions, labels=np.zeros_like(regions.labels), keys=folders)
    of_folders.labels[rows] = place
    asked = rows[~is_first]
    scores = of_folders.classifier(rows[is_first]).scores(regions.examples[asked])
    at = ranks(*of_folders.of_photos(asked, scores))
    print(
        f"dishes, another photograph: first {np.mean(at < 1):.1%}, five {np.mean(at < 5):.1%} of {len(at)}"
    )


def print_few(regions: Regions) -> None:
    """4: nothing is known but one photograph, or three of three specimens, of each food."""
    rows = np.flatnonzero(regions.sources == ECUSTFD)
    labels, specimens = regions.labels[rows], regions.specimens[rows]
    for count in (1, 3):
        rng, at = np.random.default_rng(0), []
        for _ in range(EPISODES):
            chosen = [
                rng.choice(np.flatnonzero(specimens == specimen))
                for label in np.unique(labels)
                for specimen in rng.permutation(np.unique(specimens[labels == label]))[:count]
            ]
            asked = np.flatnonzero(~np.isin(specimens, specimens[chosen]))
            scores = regions.classifier(rows[chosen]).scores(regions.examples[rows[asked]])
            at.append(ranks(scores, labels[asked]))
        found = np.concatenate(at)
        print(
            f"{count} photographs of each of {len(np.unique(labels))} foods: "
            f"first {np.mean(found < 1):.1%}, first three {np.mean(found < 3):.1%}"
        )


def print_learning(regions: Regions) -> None:
    """5: each food of ECUSTFD left out, then a picture of each of its other specimens confirmed, one by one."""
    counts = (1, 2, 3, 5, 8)
    found: dict[int, list[tuple[int, int]]] = {count: [] for count in counts}
    boxed = regions.sources == ECUSTFD
    for place in np.unique(regions.labels[boxed]):
        others = np.flatnonzero(regions.labels != place)
        own = np.flatnonzero((regions.labels == place) & boxed)
        for name in np.unique(regions.specimens[own]):
            asked, pool = own[regions.specimens[own] == name], own[regions.specimens[own] != name]
            _, firsts = np.unique(regions.specimens[pool], return_index=True)
            order = [*pool[np.sort(firsts)], *np.delete(pool, firsts)]
            for count in counts:
                if len(order) >= count:
                    rows = np.concatenate([others, order[:count]]).astype(np.intp)
                    scores = regions.classifier(rows).scores(regions.examples[asked])
                    eaten = np.zeros(len(regions.keys))
                    eaten[place] = count  # at this time of day; nobody else has eaten anything
                    habit = log_prior(eaten, np.zeros_like(eaten))
                    label = np.full(len(asked), place)
                    likely = scores / shipped_index().calibration.temperature + habit
                    found[count] += zip(ranks(scores, label), ranks(likely, label), strict=True)
    print("a new food, confirmed   by looks alone:                by looks and habit:")
    print("                        first   first 3   first 5      first   first 3   first 5")
    for count in counts:
        at = np.array(found[count])
        shares = [np.mean(at[:, way] < most) for way in (0, 1) for most in (1, 3, 5)]
        print(
            f"{count:>3} times          {shares[0]:>10.0%}{shares[1]:>10.0%}{shares[2]:>10.0%}"
            f"{shares[3]:>11.0%}{shares[4]:>10.0%}{shares[5]:>10.0%}"
        )


def ranks(scores: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(n,) how many classes score higher than the right one."""
    return (scores > scores[np.arange(len(labels)), labels][:, None]).sum(axis=1)


def without_specimen(index: FoodIndex, specimen: str) -> Identifier:
    kept = np.array(index.specimens) != specimen
    rest = replace(
        index,
        examples=index.examples[kept],
        labels=index.labels[kept],
        specimens=tuple(np.array(index.specimens)[kept].tolist()),
    )
    return Identifier(NumberedIndex(rest), none_prior=UNPOINTED_NONE_PRIOR)


def print_light(foods: Sequence[LabelledFood], key_of: dict[tuple[str, str], str]) -> None:
    lights: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        name: (lambda pixels, gains=gains: disturbed(pixels, gains))
        for name, gains in WHITE_BALANCES.items()
    }
    lights |= {
        name: (lambda pixels, by=by: disturbed(pixels, (by, by, by)))
        for name, by in EXPOSURES.items()
    }
    print("\nlight                     first    five")
    for name, change in lights.items():
        first = five = 0
        for food in foods:
            region = region_of_box(change(read(food.photo)), food.box)
            found = without_specimen(shipped_index(), food.specimen).identify(describe(region))
            names = [one.food_key for one in found.candidates[:5]]
            key = key_of[ECUSTFD, food.label]
            first, five = first + (names[0] == key), five + (key in names)
        print(f"{name:<22}{first / len(foods):>9.1%}{five / len(foods):>8.1%}")


def print_without_box(photos: Path, every: int, key_of: dict[tuple[str, str], str]) -> None:
    asked = {
        ECUSTFD: [
            (food.photo, food.specimen, key_of[ECUSTFD, food.label])
            for food in labelled_foods(photos / ECUSTFD)
        ],
        GROCERY: [
            (photo.path, photo.specimen, key_of[GROCERY, photo.label])
            for photo in labelled_photos(photos / "foods" / GROCERY)
            if (GROCERY, photo.label) in key_of
        ],
    }
    print()
    for source, all_of_it in asked.items():
        first = five = 0
        chosen = all_of_it[::every]
        for path, specimen, key in chosen:
            found = identify_unpointed(read(path), without_specimen(shipped_index(), specimen))[0]
            names = [one.food_key for one in found.identification.candidates[:5]]
            first, five = first + (names[0] == key), five + (key in names)
        shares = f"first {first / len(chosen):.1%}, five {five / len(chosen):.1%} of {len(chosen)}"
        print(f"without a box, {source}: {shares}")


def print_mixed(folder: Path, key_of: dict[tuple[str, str], str]) -> None:
    identifier = Identifier(NumberedIndex(shipped_index()), none_prior=NONE_PRIOR)
    chances, ranks = [], []
    for path in sorted((folder / "images").glob("mix*.jpg")):
        pixels = np.asarray(cv2.imread(str(path)))
        for label, box in boxes_of(path, folder / "boxes" / f"{path.stem}.xml"):
            key = key_of.get((ECUSTFD, label))
            region = region_of_box(pixels, box) if key else None
            if region is None:
                continue
            ranked = identifier.identify(describe(region)).candidates
            chances.append(ranked[0].probability)
            ranks.append([one.food_key for one in ranked].index(key))
    at = np.array(ranks)
    error = expected_calibration_error(np.array(chances), at == 0)
    named = f"first {np.mean(at < 1):.1%}, five {np.mean(at < 5):.1%}"
    print(f"\ntwo foods on a plate: {named}, ECE {error:.3f} of {len(at)} regions")


def print_time(foods: Sequence[LabelledFood]) -> None:
    identifier = Identifier(NumberedIndex(shipped_index()))
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


def read(path: Path) -> np.ndarray:
    return np.asarray(cv2.imread(str(path)))


def equal(classes: int) -> np.ndarray:
    return np.full(classes, -np.log(classes))


if __name__ == "__main__":
    raise SystemExit(main())
