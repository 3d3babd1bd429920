"""Builds the index that ships from a folder of labelled photographs.

    python -m tools.food_index.build FOLDER -o app/identification/shipped/ecustfd.npz

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

from app.core.errors import Failure, InvalidInputError
from app.identification.food_index import FoodIndex, KnownFood, shipped_foods
from app.identification.metric import BlockLayout, Vectors
from app.vision.looks.vcm import BLOCKS, VCM_VERSION, describe
from app.vision.looks.vcm_region import SIDE_PX, Box, region_of_box
from app.vision.photo import read_photo
from tools.ecustfd import read_specimens
from tools.food_index.calibration import fit_calibration
from tools.food_index.held_out import scores_of_unseen_classes, scores_of_unseen_specimens
from tools.food_index.metric import fit_metric

SOURCE = "ecustfd"
DIGEST = re.compile(r" [0-9a-f]{12}$")  # of the content, at the end of a version
NAME = re.compile(r"(?P<label>[a-z_]+?)(?P<specimen>\d+)[ST]\(\d+\)", re.ASCII)
MAX_PIXELS = 64_000_000
LAYOUT = tuple(BlockLayout(block.name, block.size, block.kind == "histogram") for block in BLOCKS)


@dataclass(frozen=True, slots=True)
class LabelledFood:
    """A food in a photograph: what it is, which specimen, its box in the photograph's pixels."""

    photo: Path
    label: str
    specimen: str
    box: Box


def build_index(folder: Path, known: Sequence[KnownFood]) -> FoodIndex:
    """The index of all labelled foods in a folder. known: the labels that it is to have, in their order.

    Raises InvalidInputError where the folder is laid out otherwise or a photograph cannot be read.
    """
    number = {food.label: place for place, food in enumerate(known)}
    described = [(food, describe_food(food)) for food in labelled_foods(folder) if food.label in number]
    if not described:
        raise InvalidInputError(f"{folder} has no labelled photographs: images/*.jpg and boxes/*.xml are expected.")
    vectors = np.stack([vector for _, vector in described]).astype(np.float16).astype(np.float64)  # as it is stored
    labels = np.array([number[food.label] for food, _ in described], np.intp)
    specimens = tuple(food.specimen for food, _ in described)
    metric = fit_metric(vectors, LAYOUT)
    examples = metric.embed(vectors)
    scores, has_another = scores_of_unseen_specimens(examples, labels, specimens, len(known))
    calibration = fit_calibration(
        scores[has_another], labels[has_another], scores_of_unseen_classes(examples, labels, len(known))
    )
    return FoodIndex(
        version=SOURCE,
        vcm_version=VCM_VERSION,
        foods=tuple(known),
        vectors=vectors,
        labels=labels,
        specimens=specimens,
        layout=LAYOUT,
        metric=metric,
        calibration=calibration,
        volumes_ml=_volumes(folder / "density.xls", number),
    )


def write_index(path: Path, index: FoodIndex) -> None:
    """The archive that read_index reads; the same index gives the same bytes. Vectors are kept in half precision."""
    sizes = [(food.label, volume) for food in index.foods for volume in index.volumes_ml.get(food.label, ())]
    np.savez_compressed(
        path,
        allow_pickle=False,
        source=np.array(DIGEST.sub("", index.version)),
        vcm_version=np.array(index.vcm_version),
        label_names=np.array([food.label for food in index.foods]),
        vectors=index.vectors.astype(np.float16),
        labels=index.labels.astype(np.uint8 if len(index.foods) < 256 else np.uint16),
        specimens=np.array(index.specimens),
        block_names=np.array([block.name for block in index.layout]),
        block_sizes=np.array([block.size for block in index.layout], np.int32),
        block_is_histogram=np.array([block.is_histogram for block in index.layout]),
        centre=index.metric.centre,
        sd=index.metric.sd,
        weight=index.metric.weight,
        calibration=np.array([index.calibration.temperature, index.calibration.none_score]),
        volume_labels=np.array([label for label, _ in sizes]),
        volumes_ml=np.array([volume for _, volume in sizes], np.float64),
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
    across, down = photo_width / width, photo_height / height  # a photograph may have been reduced after it was boxed
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
        x0, y0, x1, y1 = (int(each.findtext(f"bndbox/{side}", "")) for side in ("xmin", "ymin", "xmax", "ymax"))
        found.append((each.findtext("name", ""), (x0, y0, x1, y1)))
    return int(root.findtext("size/width", "")), int(root.findtext("size/height", "")), found


def _size(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return image.size


def _volumes(path: Path, labels: dict[str, int]) -> dict[str, tuple[float, ...]]:
    measured = read_specimens(path) if path.exists() else {}
    return {
        label: tuple(one.volume_ml for one in specimens) for label, specimens in measured.items() if label in labels
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m tools.food_index.build", description="Build the index that ships.")
    parser.add_argument("folder", type=Path, help="labelled photographs, laid out as ECUSTFD is")
    parser.add_argument("-o", "--output", type=Path, default=Path("index.npz"), help="the archive to write")
    options = parser.parse_args(arguments)
    index = build_index(options.folder, shipped_foods())
    write_index(options.output, index)
    regions, specimens = len(index.vectors), len(set(index.specimens))
    sys.stdout.write(f"{regions} regions of {specimens} specimens, {len(index.foods)} foods: {options.output}\n")


if __name__ == "__main__":
    main()
