"""Builds the index that ships from a folder of labelled photographs.

    python -m tools.food_index FOLDER -o app/identification/shipped/ecustfd.npz

The folder is laid out as ECUSTFD is (Liang and Li, "Computer vision-based food calorie estimation: dataset, method,
and experiment", arXiv:1705.07632, 2017): images/*.jpg, a box a food in boxes/*.xml (Pascal VOC), each specimen's volume
in density.xls. A file's name tells label, specimen, view and number: apple012S(3).jpg. Only figures come out of it.
"""

import argparse
import re
import sys
import xml.etree.ElementTree as ET  # a local folder that the command's user chose
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from app.candidates.labelled_folder import LAYOUT
from app.core.errors import Failure, InvalidInputError
from app.identification.build_index import build_index, write_index
from app.identification.food_index import FoodIndex, KnownFood, shipped_foods
from app.identification.metric import Vectors
from app.vision.looks.vcm import VCM_VERSION, describe
from app.vision.looks.vcm_region import SIDE_PX, Box, region_of_box
from app.vision.photograph.photo import read_photo
from tools.ecustfd import read_specimens

SOURCE = "ecustfd"
NAME = re.compile(r"(?P<label>[a-z_]+?)(?P<specimen>\d+)[ST]\(\d+\)", re.ASCII)
MAX_PIXELS = 64_000_000


@dataclass(frozen=True, slots=True)
class LabelledFood:
    """A food in a photograph: what it is, which specimen, its box in the photograph's pixels."""

    photo: Path
    label: str
    specimen: str
    box: Box


def build_shipped(folder: Path, known: Sequence[KnownFood]) -> FoodIndex:
    """The index of all labelled foods in a folder. known: the labels that it is to have, in their order.

    Raises InvalidInputError where the folder is laid out otherwise or a photograph cannot be read.
    """
    number = {food.label: place for place, food in enumerate(known)}
    described = [
        (food, describe_food(food)) for food in labelled_foods(folder) if food.label in number
    ]
    if not described:
        raise InvalidInputError(
            f"{folder} has no labelled photographs: images/*.jpg and boxes/*.xml are expected."
        )
    return build_index(
        SOURCE,
        VCM_VERSION,
        known,
        np.stack([vector for _, vector in described]),
        np.array([number[food.label] for food, _ in described], np.intp),
        [food.specimen for food, _ in described],
        LAYOUT,
        _volumes(folder / "density.xls", number),
    )


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


def _volumes(path: Path, labels: dict[str, int]) -> dict[str, tuple[float, ...]]:
    measured = read_specimens(path) if path.exists() else {}
    return {
        label: tuple(one.volume_ml for one in specimens)
        for label, specimens in measured.items()
        if label in labels
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.food_index", description="Build the index that ships."
    )
    parser.add_argument("folder", type=Path, help="labelled photographs, laid out as ECUSTFD is")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("index.npz"), help="the archive to write"
    )
    options = parser.parse_args(arguments)
    index = build_shipped(options.folder, shipped_foods())
    write_index(options.output, index)
    regions, specimens = len(index.vectors), len(set(index.specimens))
    sys.stdout.write(
        f"{regions} regions of {specimens} specimens, {len(index.foods)} foods: {options.output}\n"
    )


if __name__ == "__main__":
    main()
