"""Build an index from a folder of labelled photographs: `tada index build FOLDER`.

FOLDER/<label>/<specimen>/*.jpg, or FOLDER/<label>/*.jpg, where each photograph is a specimen of its
own. Beside them, if wanted: foods.csv (label, name, food_key), boxes.csv (photo, x, y, width,
height in px) and volumes.csv (label, volume_ml). docs/identification.md, "An index for another food
culture", has an example.
"""

import csv
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.core.errors import Failure, InvalidInputError
from app.identification.build_index import build_index
from app.identification.food_index import FoodIndex, KnownFood, read_labels, shipped_index
from app.identification.metric import Vectors
from app.vision.looks.vcm import VCM_VERSION, describe
from app.vision.looks.vcm_region import SIDE_PX, Box, region_of_box, regions_of_whole
from app.vision.photograph.photo import read_photo

PHOTOGRAPHS = frozenset({".jpg", ".jpeg", ".png", ".webp", ".heic", ".heif"})
SPECIMEN_DEPTH = 3  # parts of <label>/<specimen>/<photo>


@dataclass(frozen=True, slots=True)
class LabelledPhoto:
    """A photograph of one food.

    name: its path in the folder
    box: around the food, px upright; None: not known
    """

    path: Path
    name: str
    label: str
    specimen: str
    box: Box | None


def build_from_folder(
    folder: Path,
    source: str,
    *,
    max_pixels: int,
    on_photo: Callable[[int, int], object] = lambda *_: None,
) -> FoodIndex:
    """Return the index of a folder. on_photo hears how many of how many photographs are described.

    Raises InvalidInputError, code `index_folder_invalid` or `index_too_small`, naming the file that
    is wrong.
    """
    photos = list(labelled_photos(folder))
    if not photos:
        raise _invalid(f"{folder} has no photographs in folders named after foods.")
    foods = _foods(folder, sorted({photo.label for photo in photos}))
    place = {food.label: number for number, food in enumerate(foods)}
    vectors, shown = [], []
    for number, photo in enumerate(photos, start=1):
        views = describe_labelled(photo, max_pixels)
        vectors.append(views)
        shown += [photo] * len(views)
        on_photo(number, len(photos))
    return build_index(
        source,
        VCM_VERSION,
        foods,
        np.concatenate(vectors),
        np.array([place[photo.label] for photo in shown], np.intp),
        [photo.specimen for photo in shown],
        shipped_index().metric,
        _volumes(folder, place.keys()),
    )


def labelled_photos(folder: Path) -> Iterator[LabelledPhoto]:
    """Yield the folder's photographs in the order of their paths.

    Raises InvalidInputError as above.
    """
    boxes = _boxes(folder)
    for path in sorted(folder.glob("*/**/*")):
        parts = path.relative_to(folder).parts
        if path.suffix.lower() not in PHOTOGRAPHS or any(part.startswith(".") for part in parts):
            continue
        if len(parts) > SPECIMEN_DEPTH:
            raise _invalid(
                f"{path} lies too deep: FOLDER/<label>/<specimen>/<photograph> is expected."
            )
        name = "/".join(parts)
        # of a photograph directly under its label this is its own name
        specimen = "/".join(parts[:2])
        yield LabelledPhoto(path, name, parts[0], specimen, boxes.pop(name, None))
    if boxes:
        raise _invalid(
            f"boxes.csv names photographs that {folder} does not have: {', '.join(sorted(boxes)[:5])}."
        )


def describe_labelled(photo: LabelledPhoto, max_pixels: int) -> Vectors:
    """(n, d) the food in a photograph: once by its box, twice where it has none (regions_of_whole).

    Raises InvalidInputError if it cannot be read or lacks the box.
    """
    try:
        content = photo.path.read_bytes()
    except OSError as error:
        raise _invalid(f"{photo.path} cannot be read: {error.strerror}.") from None
    read = read_photo(content, max_pixels=max_pixels, least_short_side_px=SIDE_PX)
    if isinstance(read, Failure):
        raise _invalid(f"{photo.path}: {read.message}")
    if photo.box is None:
        regions = regions_of_whole(read.pixels_bgr)
    elif (region := region_of_box(read.pixels_bgr, photo.box)) is not None:
        regions = (region,)
    else:
        raise _invalid(f"{photo.path}: its box lies outside it.")
    return np.stack([describe(region) for region in regions]).astype(np.float64)


def _foods(folder: Path, labels: Sequence[str]) -> list[KnownFood]:
    """Return the foods of labels: as foods.csv says, or else the label is the key of the food."""
    path = folder / "foods.csv"
    try:
        named = (
            {food.label: food for food in read_labels(path.read_text("utf-8"))}
            if path.exists()
            else {}
        )
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise _invalid(
            f"{path} needs the columns label, name and food_key, each food once: {error}."
        ) from None
    if unused := sorted(named.keys() - set(labels)):
        raise _invalid(
            f"{path} names labels that the folder does not have: {', '.join(unused[:5])}."
        )
    foods = [named.get(label) or KnownFood(label, label, label) for label in labels]
    keys = [food.food_key for food in foods]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise _invalid(f"Several labels are of one food: {', '.join(twice)}.")
    return foods


def _boxes(folder: Path) -> dict[str, Box]:
    boxes: dict[str, Box] = {}
    for row in _rows(folder / "boxes.csv"):
        sides = [_number(row.get(side)) for side in ("x", "y", "width", "height")]
        if not row.get("photo") or None in sides or row["photo"] in boxes:
            raise _invalid(
                f"{folder}/boxes.csv: each line needs photo (once), x, y, width and height in px: {row}."
            )
        x, y, width, height = (side for side in sides if side is not None)
        boxes[row["photo"]] = (x, y, width, height)
    return boxes


def _volumes(folder: Path, labels: Collection[str]) -> dict[str, tuple[float, ...]]:
    volumes: dict[str, tuple[float, ...]] = {}
    for row in _rows(folder / "volumes.csv"):
        label, volume_ml = row.get("label") or "", _number(row.get("volume_ml"))
        if label not in labels or volume_ml is None or volume_ml <= 0.0:
            raise _invalid(
                f"{folder / 'volumes.csv'}: each line needs a label of the folder and volume_ml > 0: {row}."
            )
        volumes[label] = (*volumes.get(label, ()), volume_ml)
    return volumes


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))
    except (csv.Error, UnicodeDecodeError) as error:
        raise _invalid(f"{path} is no CSV file in UTF-8: {error}.") from None


def _number(text: str | None) -> float | None:
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _invalid(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="index_folder_invalid")
