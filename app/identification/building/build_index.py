"""Build an index of foods from described regions and write it as an archive that read_index reads.

Vectors with labels and specimens in -> FoodIndex, its metric and its calibration fitted to them. Reading photographs is
left to others.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.core.errors import InvalidInputError
from app.identification.building.fit_calibration import fit_calibration
from app.identification.building.fit_metric import fit_metric
from app.identification.building.held_out import (
    scores_of_unseen_classes,
    scores_of_unseen_specimens,
)
from app.identification.food_index import FoodIndex, KnownFood
from app.identification.metric import BlockLayout, Vectors

DIGEST = re.compile(r" [0-9a-f]{12}$")  # of the content, at the end of a version
FEWEST_FOODS = 2


def build_index(
    source: str,
    vcm_version: str,
    foods: Sequence[KnownFood],
    vectors: Vectors,
    labels: NDArray[np.intp],
    specimens: Sequence[str],
    layout: Sequence[BlockLayout],
    volumes_ml: Mapping[str, tuple[float, ...]],
) -> FoodIndex:
    """Return the index of these regions, calibrated on specimens and foods that were held out.

    vectors: (n, d). labels: (n,) places in foods. specimens: n names, the same for pictures of one piece. volumes_ml:
    of each label's pieces. Raises InvalidInputError, code `index_too_small`, unless there are two foods, one of them
    with two specimens: nothing can be held out of less.
    """
    stored = vectors.astype(np.float16).astype(np.float64)
    pieces = {(int(label), specimen) for label, specimen in zip(labels, specimens, strict=True)}
    if len(set(labels.tolist())) < FEWEST_FOODS or len(pieces) == len(set(labels.tolist())):
        raise InvalidInputError(
            "An index needs photographs of two foods, and of two specimens of one of them.",
            code="index_too_small",
        )
    metric = fit_metric(stored, layout)
    examples = metric.embed(stored)
    scores, has_another = scores_of_unseen_specimens(examples, labels, specimens, len(foods))
    unknown = scores_of_unseen_classes(examples, labels, len(foods))
    return FoodIndex(
        version=source,
        vcm_version=vcm_version,
        foods=tuple(foods),
        vectors=stored,
        labels=labels,
        specimens=tuple(specimens),
        layout=tuple(layout),
        metric=metric,
        calibration=fit_calibration(scores[has_another], labels[has_another], unknown),
        volumes_ml=volumes_ml,
    )


def write_index(path: Path, index: FoodIndex) -> None:
    """The archive that read_index reads; the same index gives the same bytes. Vectors are kept in half precision."""
    sizes = [
        (food.label, volume)
        for food in index.foods
        for volume in index.volumes_ml.get(food.label, ())
    ]
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


def write_labels(path: Path, foods: Sequence[KnownFood]) -> None:
    """Write the lines that read_labels reads."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("label", "name", "food_key"))
        writer.writerows((food.label, food.name, food.food_key) for food in foods)
