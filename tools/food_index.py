"""Builds the index that ships from three collections of labelled photographs.

    python -m tools.food_index PHOTOS app/identification/shipped/foods.npz

PHOTOS holds ecustfd/ (Liang and Li, "Computer vision-based food calorie estimation: dataset, method,
and experiment", arXiv:1705.07632, 2017: images/*.jpg, a box a food in boxes/*.xml (Pascal VOC), each
specimen's volume in density.xls; a file's name tells label, specimen, view and number:
apple012S(3).jpg) and, one folder a food, foods/grocery/ (Klasson et al., "A hierarchical grocery
store image dataset", WACV 2019) and foods/dishes/ (Bettina-Elena and Cristea, ffml_dataset).
labels.csv beside this file says which folder shows which food of the starter table. Only figures
come out of it.
"""

import argparse
import csv
import re
import sys
import xml.etree.ElementTree as ET  # a local folder that the command's user chose
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from app.candidates.labelled_folder import describe_labelled, labelled_photos
from app.core.errors import Failure, InvalidInputError
from app.identification.build_index import build_index, write_index, write_labels
from app.identification.food_index import FoodIndex, KnownFood, labels_path
from app.identification.metric import Vectors
from app.nutrition.foods import load_starter_table
from app.vision.looks.vcm import VCM_VERSION, describe
from app.vision.looks.vcm_region import SIDE_PX, Box, region_of_box
from app.vision.photograph.photo import read_photo
from tools.ecustfd import read_specimens
from tools.food_metric import fit_metric

SOURCE = "ecustfd, shops, dishes"
ECUSTFD, GROCERY, DISHES = "ecustfd", "grocery", "dishes"
UNBOXED = (GROCERY, DISHES)
LABELS = Path(__file__).parent / "shipped_index" / "labels.csv"
NAME = re.compile(r"(?P<label>[a-z_]+?)(?P<specimen>\d+)[ST]\(\d+\)", re.ASCII)
MAX_PIXELS = 64_000_000


@dataclass(frozen=True, slots=True)
class LabelledFood:
    """A food in a photograph: what it is, which specimen, its box in the photograph's pixels."""

    photo: Path
    label: str
    specimen: str
    box: Box


@dataclass(frozen=True, slots=True)
class DescribedFood:
    """A food of one photograph. views: (n, d).

    specimen: of a dish its folder, whose photographs show one serving
    """

    source: str
    key: str
    specimen: str
    views: Vectors


def build_shipped(photos: Path) -> FoodIndex:
    """Return the index of all photographs that labels.csv names.

    photos: the folder of ecustfd/, foods/grocery/ and foods/dishes/
    Raises InvalidInputError where it is laid out otherwise or a photograph cannot be read.
    """
    shown = list(described_foods(photos))
    if not shown:
        raise InvalidInputError(f"{photos} has no labelled photographs.")
    keys = sorted({food.key for food in shown})
    names = {food.key: food.name for food in load_starter_table().foods}
    vectors = np.concatenate([food.views for food in shown])
    counts = [len(food.views) for food in shown]
    return build_index(
        SOURCE,
        VCM_VERSION,
        [KnownFood(key, names.get(key, key.capitalize()), key) for key in keys],
        vectors,
        np.repeat([keys.index(food.key) for food in shown], counts),
        np.repeat([food.specimen for food in shown], counts).tolist(),
        fit_metric(vectors),
        _volumes(photos / ECUSTFD / "density.xls"),
    )


def described_foods(photos: Path) -> Iterator[DescribedFood]:
    """Yield the foods of all photographs that labels.csv names, as they look; see build_shipped."""
    key_of = read_labels_of_sources(LABELS)
    for food in labelled_foods(photos / ECUSTFD):
        yield DescribedFood(
            ECUSTFD, key_of[ECUSTFD, food.label], food.specimen, describe_food(food)[None]
        )
    for source in UNBOXED:
        for photo in labelled_photos(photos / "foods" / source):
            if key := key_of.get((source, photo.label)):
                specimen = photo.label if source == DISHES else photo.specimen
                yield DescribedFood(source, key, specimen, describe_labelled(photo, MAX_PIXELS))


def read_labels_of_sources(path: Path) -> dict[tuple[str, str], str]:
    """Return (source, folder) -> key of the food; a specimen's name in ECUSTFD begins with its label."""
    with path.open(encoding="utf-8", newline="") as file:
        return {(row["source"], row["folder"]): row["food_key"] for row in csv.DictReader(file)}


def labelled_foods(folder: Path) -> Iterator[LabelledFood]:
    """The foods of photographs that show one specimen, by file name; mixed plates have no number to tell them apart."""
    for path in sorted((folder / "images").glob("*.jpg")):
        named, boxes = NAME.fullmatch(path.stem), folder / "boxes" / f"{path.stem}.xml"
        if named is None or not boxes.exists():
            continue
        for label, box in boxes_of(path, boxes):
            if label == named["label"]:
                yield LabelledFood(path, label, f"{label}{named['specimen']}", box)


def boxes_of(photo: Path, boxes: Path) -> Iterator[tuple[str, Box]]:
    """Label and box, in the photograph's pixels, of each thing that was boxed in it; the coin beside the food too."""
    width, height, found = _read_boxes(boxes)
    photo_width, photo_height = _size(photo)
    across, down = (
        photo_width / width,
        photo_height / height,
    )  # a photograph may have been reduced after it was boxed
    for label, (x0, y0, x1, y1) in found:
        yield label, (x0 * across, y0 * down, (x1 - x0) * across, (y1 - y0) * down)


def describe_food(food: LabelledFood) -> Vectors:
    """(d,) VCM of a labelled food. Raises InvalidInputError if the photograph cannot be read or lacks the box."""
    photo = read_photo(food.photo.read_bytes(), max_pixels=MAX_PIXELS, least_short_side_px=SIDE_PX)
    if isinstance(photo, Failure):
        raise InvalidInputError(f"{food.photo}: {photo.message}")
    region = region_of_box(photo.pixels_bgr, food.box)
    if region is None:
        raise InvalidInputError(f"{food.photo}: its box lies outside it.")
    return describe(region).astype(np.float64)


def _read_boxes(path: Path) -> tuple[int, int, list[tuple[str, tuple[int, int, int, int]]]]:
    """Width and height of the photograph as it was boxed, px; label and (x0, y0, x1, y1) of each object."""
    root = ET.parse(path).getroot()  # noqa: S314  # see the import
    found = []
    for each in root.iter("object"):
        x0, y0, x1, y1 = (
            int(each.findtext(f"bndbox/{side}", "")) for side in ("xmin", "ymin", "xmax", "ymax")
        )
        found.append((each.findtext("name", ""), (x0, y0, x1, y1)))
    return int(root.findtext("size/width", "")), int(root.findtext("size/height", "")), found


def _size(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return image.size


def _volumes(path: Path) -> dict[str, tuple[float, ...]]:
    measured = read_specimens(path) if path.exists() else {}
    key_of = read_labels_of_sources(LABELS)
    return {
        key_of[ECUSTFD, label]: tuple(one.volume_ml for one in specimens)
        for label, specimens in measured.items()
        if (ECUSTFD, label) in key_of
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.food_index", description="Build the index that ships."
    )
    parser.add_argument("photos", type=Path, help="the folder of ecustfd/ and foods/")
    parser.add_argument("output", type=Path, help="the archive to write; its labels beside it")
    options = parser.parse_args(arguments)
    index = build_shipped(options.photos)
    write_index(options.output, index)
    write_labels(labels_path(options.output), index.foods)
    regions, specimens = len(index.examples), len(set(index.specimens))
    sys.stdout.write(
        f"{regions} regions of {specimens} specimens, {len(index.foods)} foods: {options.output}\n"
    )


if __name__ == "__main__":
    main()
