"""How far volumes of real photographs are from measured ones: ECUSTFD, by the coin that lies in each of them.

    python benchmarks/weighed_photographs.py [--side] [--told] [--half other] [--data FOLDER] [--jobs N] [--only LABEL]

Reads photos/ecustfd of FOLDER (by default TADA_SHARED_DATA or ../shared), and density.xls there, which needs xlrd (dev
extra). One photograph from above of each specimen, with --side that from the side as well, a 25 mm coin for the scale,
the camera unknown; a point in the middle of what stands out in its box says where the food is, and with --told what the
food table has for it counts. Specimens are split by their names in two
halves: look at the other one rarely. Two yardsticks, each by the other specimens of the food: their mean volume, and
their mean ratio of volume to the area of the food's box to the power of 1.5, in coins.
"""

import argparse
import os
import statistics
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from app.core.errors import Failure
from app.meals.estimate.estimate_json import scale_by, with_forms
from app.meals.estimate.run_estimate import run_estimate
from app.nutrition.foods import Food, load_starter_table
from app.vision.looks.vcm_region import MARGIN, SIDE_PX, Box, region_of_box
from app.vision.model import EstimateOptions, Hint
from app.vision.photograph.photo import read_photo
from benchmarks.food_mass import TABLE_FOODS
from tools.ecustfd import read_specimens
from tools.food_index import MAX_PIXELS, NAME, boxes_of

ROOT = Path(__file__).resolve().parents[1]
COIN = "coin:25.0"
HALVES = ("first", "other")


@dataclass(frozen=True)
class Photographed:
    """One specimen from above. point: px, in the food's box. coins: the box's area over the coin's."""

    photo: Path
    side: Path | None
    label: str
    specimen: str
    true_ml: float
    point: tuple[float, float]
    coins: float


@dataclass(frozen=True)
class Measured:
    """volume_ml, interval_ml: None where it could not be measured. code: why."""

    of: Photographed
    volume_ml: float | None
    interval_ml: tuple[float, float] | None
    code: str = ""


def photographed(folder: Path, half: str) -> Iterator[Photographed]:
    """Yield one photograph from above of each specimen of a half, if there is any with one from the side as well."""
    of_labels = read_specimens(folder / "density.xls").values()
    volumes = {each.name: each.volume_ml for specimens in of_labels for each in specimens}
    taken = set()
    above = sorted((folder / "images").glob("*T(*).jpg"))
    for path in sorted(above, key=lambda path: side_of(path) is None):
        named = NAME.fullmatch(path.stem)
        if named is None:
            continue
        specimen = f"{named['label']}{named['specimen']}"
        if specimen in taken or specimen not in volumes or half_of(specimen) != half:
            continue
        boxes = dict(boxes_of(path, folder / "boxes" / f"{path.stem}.xml"))
        if named["label"] not in boxes or "coin" not in boxes:
            continue
        taken.add(specimen)
        _, _, width, height = boxes[named["label"]]
        coins = width * height / (boxes["coin"][2] * boxes["coin"][3])
        point = point_of(path, boxes[named["label"]])
        yield Photographed(
            path, side_of(path), named["label"], specimen, volumes[specimen], point, coins
        )


def point_of(path: Path, box: Box) -> tuple[float, float]:
    """Return the place, px, in what stands out in a box, farthest from its outline: on a banana, not beside it."""
    x, y, width, height = box
    pixels = read_photo(path.read_bytes(), max_pixels=MAX_PIXELS)
    region = None if isinstance(pixels, Failure) else region_of_box(pixels.pixels_bgr, box)
    if region is None:
        return x + width / 2, y + height / 2
    depth = cv2.distanceTransform(region.mask.astype(np.uint8), cv2.DIST_L2, 5)
    row, column = np.unravel_index(depth.argmax(), depth.shape)
    scale = SIDE_PX / max(width, height)
    left, top = int(max(0.0, x - MARGIN * width)), int(max(0.0, y - MARGIN * height))
    return left + float(column) / scale, top + float(row) / scale


def side_of(above: Path) -> Path | None:
    """Return the photograph from the side that was taken with one from above."""
    side = above.with_name(above.name.replace("T(", "S("))
    return side if side.exists() else None


def half_of(specimen: str) -> str:
    """Return which half a specimen is in; all its photographs are in the same."""
    return HALVES[zlib.crc32(specimen.encode()) % 2]


def hint_of(shown: Photographed, food: Food | None) -> Hint:
    """Return where the food is, and what the food table has for it if it is told."""
    hint = Hint(point=shown.point, food=food.key if food else None)
    options = with_forms(EstimateOptions(None, hints=(hint,)), {food.key: food} if food else {})
    return options.hints[0]


def measure(shown: Photographed, hint: Hint, is_side_used: bool) -> Measured:
    """Measure one photograph, or two."""
    options = EstimateOptions(None, known=scale_by(COIN).known, hints=(hint,))
    answer, _ = run_estimate(
        {"left": shown.photo} | ({"right": shown.side} if is_side_used and shown.side else {}),
        options,
        max_pixels=MAX_PIXELS,
        on_stage=lambda _: None,
        want_artefacts=False,
    )
    if answer.failure is not None:
        return Measured(shown, None, None, answer.failure.code)
    item = next(item for item in answer.items if item.hint == 0)
    interval = item.volume_interval_ml
    return Measured(
        shown,
        item.volume_ml,
        None if interval is None else (interval[0], interval[1]),
        *item.flags[:1],
    )


def yardsticks(rows: Sequence[Measured]) -> dict[str, float]:
    """Return the mean error, per cent, of what needs no measurement, by the other specimens of each food."""
    by_label = defaultdict(list)
    for row in rows:
        by_label[row.of.label].append(row.of)
    constant, area = [], []
    for specimens in by_label.values():
        for each in specimens:
            others = [other for other in specimens if other is not each]
            if others:
                mean = statistics.mean(other.true_ml for other in others)
                ratio = statistics.mean(other.true_ml / other.coins**1.5 for other in others)
                constant.append(abs(mean / each.true_ml - 1))
                area.append(abs(ratio * each.coins**1.5 / each.true_ml - 1))
    return {
        "constant per food": 100 * statistics.mean(constant),
        "area^1.5 per food": 100 * statistics.mean(area),
    }


def lines(rows: Sequence[Measured]) -> Iterator[str]:
    """Yield the report."""
    by_label = defaultdict(list)
    for row in rows:
        by_label[row.of.label].append(row)
    yield "| food | specimens | measured | mean error, % | bias, % | inside |"
    yield "|---|---|---|---|---|---|"
    for label, of_label in [*sorted(by_label.items()), ("all", list(rows))]:
        errors = [100 * (row.volume_ml / row.of.true_ml - 1) for row in of_label if row.volume_ml]
        inside = sum(
            row.interval_ml is not None
            and row.interval_ml[0] <= row.of.true_ml <= row.interval_ml[1]
            for row in of_label
        )
        if errors:
            mean, bias = statistics.mean(map(abs, errors)), statistics.mean(errors)
            yield f"| {label} | {len(of_label)} | {len(errors)} | {mean:.1f} | {bias:+.1f} | {inside} |"
        else:
            yield f"| {label} | {len(of_label)} | 0 | | | |"
    for name, error in yardsticks(rows).items():
        yield f"{name}: {error:.1f} %"
    refused = sorted(f"{row.of.specimen} {row.code}" for row in rows if row.volume_ml is None)
    if refused:
        yield f"not measured: {', '.join(refused)}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared"))
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--side", action="store_true")
    parser.add_argument("--told", action="store_true")
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    parser.add_argument("--only")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    folder = options.data / "photos" / "ecustfd"
    if not folder.is_dir():
        raise SystemExit(f"There are no photographs in {folder}.")
    foods = {food.key: food for food in load_starter_table().foods}
    specimens = [
        each for each in photographed(folder, options.half) if options.only in (None, each.label)
    ]
    hints = [
        hint_of(each, foods.get(TABLE_FOODS.get(each.label, "")) if options.told else None)
        for each in specimens
    ]
    with ProcessPoolExecutor(options.jobs) as processes:
        of_side = [options.side] * len(specimens)
        rows = list(processes.map(measure, specimens, hints, of_side))
    print(*lines(rows), sep="\n")


if __name__ == "__main__":
    main()
