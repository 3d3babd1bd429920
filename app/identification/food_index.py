"""The index that ships with the program: described regions of known foods, and how their likeness becomes probability.

One compressed NumPy archive of numbers and short words: no pickle, no photograph. foods.csv beside
it, which people read and correct, names the food of the food table for each label.
"""

import csv
import hashlib
import io
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from app.core.errors import InvalidInputError
from app.identification.kernel_classifier import Calibration
from app.identification.metric import Metric, Vectors

SHIPPED = "foods.npz"
LABELS = "foods.csv"
ARRAYS = (
    "source",
    "vcm_version",
    "label_names",
    "examples",
    "labels",
    "specimens",
    "centre",
    "sd",
    "axes",
    "calibration",
    "volume_labels",
    "volumes_ml",
)


@dataclass(frozen=True, slots=True)
class KnownFood:
    """A label of the index: its name for people, and the key of its food, which the food table may lack."""

    label: str
    name: str
    food_key: str


@dataclass(frozen=True, slots=True)
class FoodIndex:
    """What an index holds.

    examples: (n, k) embedded by the metric
    labels: (n,) places in foods
    specimens: (n,) names, the same for pictures of one piece or serving
    volumes_ml: of each food's measured pieces
    version: names the source and the content
    """

    version: str
    vcm_version: str
    foods: tuple[KnownFood, ...]
    examples: Vectors
    labels: NDArray[np.intp]
    specimens: tuple[str, ...]
    metric: Metric
    calibration: Calibration
    volumes_ml: Mapping[str, tuple[float, ...]]


@cache
def shipped_index() -> FoodIndex:
    """The index that tools/food_index.py built (docs/identification.md)."""
    with (_folder() / SHIPPED).open("rb") as file:
        return read_index(io.BytesIO(file.read()), shipped_foods())


@cache
def open_index(path: Path | None) -> FoodIndex:
    """Return the index in a file that `tada index build` wrote, with its labels beside it; None: the shipped one.

    Raises InvalidInputError, code `food_index_unreadable`.
    """
    if path is None:
        return shipped_index()
    try:
        foods = read_labels(labels_path(path).read_text(encoding="utf-8"))
        return read_index(io.BytesIO(path.read_bytes()), foods)
    except (OSError, ValueError, KeyError, csv.Error) as error:
        raise InvalidInputError(
            f"The index {path} cannot be read: {error}.", code="food_index_unreadable"
        ) from error


def labels_path(path: Path) -> Path:
    """Where the labels of an index are: beside it, with the suffix .csv."""
    return path.with_suffix(".csv")


def shipped_foods() -> tuple[KnownFood, ...]:
    """The labels of the shipped index and their foods."""
    return read_labels((_folder() / LABELS).read_text(encoding="utf-8"))


def read_labels(text: str) -> tuple[KnownFood, ...]:
    """Lines of label, name, food_key.

    Raises ValueError for an empty cell, or a label or a food that stands twice.
    """
    foods = tuple(
        KnownFood(row["label"], row["name"], row["food_key"])
        for row in csv.DictReader(io.StringIO(text))
    )
    if not all(food.label and food.name and food.food_key for food in foods):
        raise ValueError("a label, a name or a food_key is missing")
    for column in ({food.label for food in foods}, {food.food_key for food in foods}):
        if len(column) != len(foods):
            raise ValueError("a label or a food stands twice")
    return foods


def read_index(file: BinaryIO, known: Sequence[KnownFood]) -> FoodIndex:
    """Return the index of an archive that build_index.py wrote. known: what its labels are.

    Raises ValueError if it is no such archive, is damaged, or has an unknown label.
    """
    by_label = {food.label: food for food in known}
    held = _arrays(file)
    unknown = sorted(set(held["label_names"].tolist()) - by_label.keys())
    if unknown:
        raise ValueError(f"labels of the index that nobody knows: {', '.join(unknown)}")
    sizes: dict[str, list[float]] = {}
    for label, volume in zip(
        held["volume_labels"].tolist(), held["volumes_ml"].tolist(), strict=True
    ):
        sizes.setdefault(label, []).append(volume)
    return FoodIndex(
        version=f"{held['source']} {_digest(held)}",
        vcm_version=str(held["vcm_version"]),
        foods=tuple(by_label[label] for label in held["label_names"].tolist()),
        examples=held["examples"].astype(np.float64),
        labels=held["labels"].astype(np.intp),
        specimens=tuple(held["specimens"].tolist()),
        metric=Metric(held["centre"], held["sd"], held["axes"].astype(np.float64)),
        calibration=Calibration(*held["calibration"].tolist()),
        volumes_ml={label: tuple(volumes) for label, volumes in sizes.items()},
    )


def _arrays(file: BinaryIO) -> dict[str, NDArray[Any]]:
    """The archive's arrays by name. Raises ValueError where they do not make up an index."""
    try:
        with np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
            held = {name: archive[name] for name in ARRAYS}
    except (
        ValueError,
        KeyError,
        EOFError,
        OSError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise ValueError(f"this is no index of foods, or a damaged one: {error}") from error
    rows, length = held["examples"].shape if held["examples"].ndim == 2 else (0, 0)
    fits = (
        rows > 0
        and held["labels"].shape == held["specimens"].shape == (rows,)
        and int(held["labels"].max()) < len(held["label_names"])
        and held["centre"].shape == held["sd"].shape == held["axes"].shape[:1]
        and held["axes"].shape[1:] == (length,)
        and held["calibration"].shape == (2,)
        and all(
            np.isfinite(held[name]).all()
            for name in ("examples", "centre", "sd", "axes", "calibration")
        )
        and bool((held["sd"] > 0.0).all())
        and held["calibration"][0] > 0.0
    )
    if not fits:
        raise ValueError(
            "this is no index of foods, or a damaged one: its parts do not fit together"
        )
    return held


def _digest(held: Mapping[str, NDArray[Any]]) -> str:
    """Of all that an archive holds, in the order of the names."""
    digest = hashlib.sha256()
    for name in sorted(held):
        digest.update(
            f"{name} {held[name].dtype.str} {held[name].shape} ".encode() + held[name].tobytes()
        )
    return digest.hexdigest()[:12]


def _folder() -> Traversable:
    return resources.files("app.identification") / "shipped"
