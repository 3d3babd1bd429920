"""Build an index of foods from described regions and write it as an archive that read_index reads.

Vectors with labels and specimens in -> FoodIndex. The calibration makes held-out examples likeliest: of known
classes, no picture of whose specimen was seen (pictures of one specimen are far more alike than two
specimens are), and of classes that were left out whole, which stand for all that the index does not
know. Reading photographs is left to others.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from app.core.errors import InvalidInputError
from app.identification.food_index import FoodIndex, KnownFood
from app.identification.kernel_classifier import (
    NONE_PRIOR,
    Calibration,
    KernelClassifier,
    posterior,
)
from app.identification.metric import Metric, Vectors

DIGEST = re.compile(r" [0-9a-f]{12}$")  # of the content, at the end of a version
FEWEST_FOODS = 2


def build_index(
    source: str,
    vcm_version: str,
    foods: Sequence[KnownFood],
    vectors: Vectors,
    labels: NDArray[np.intp],
    specimens: Sequence[str],
    metric: Metric,
    volumes_ml: Mapping[str, tuple[float, ...]],
) -> FoodIndex:
    """Return the index of these regions, calibrated on specimens and foods that were held out.

    vectors: (n, d)
    labels: (n,) places in foods
    specimens: n names, the same for pictures of one piece
    volumes_ml: of each label's pieces
    Raises InvalidInputError, code `index_too_small`, unless there are two foods, one of them with
    two specimens: nothing can be held out of less.
    """
    pieces = {(int(label), specimen) for label, specimen in zip(labels, specimens, strict=True)}
    if len(set(labels.tolist())) < FEWEST_FOODS or len(pieces) == len(set(labels.tolist())):
        raise InvalidInputError(
            "An index needs photographs of two foods, and of two specimens of one of them.",
            code="index_too_small",
        )
    examples = metric.embed(vectors).astype(np.float16).astype(np.float64)
    scores, has_another = scores_of_unseen_specimens(examples, labels, specimens, len(foods))
    unknown = scores_of_unseen_classes(examples, labels, len(foods))
    return FoodIndex(
        version=source,
        vcm_version=vcm_version,
        foods=tuple(foods),
        examples=examples,
        labels=labels,
        specimens=tuple(specimens),
        metric=metric,
        calibration=fit_calibration(scores[has_another], labels[has_another], unknown),
        volumes_ml=volumes_ml,
    )


def write_index(path: Path, index: FoodIndex) -> None:
    """The archive that read_index reads; the same index gives the same bytes.

    Examples are kept in half precision.
    """
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
        examples=index.examples.astype(np.float16),
        labels=index.labels.astype(np.uint8 if len(index.foods) < 256 else np.uint16),
        specimens=np.array(index.specimens),
        centre=index.metric.centre,
        sd=index.metric.sd,
        axes=index.metric.axes.astype(np.float16),
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


# of scores that run from 0 to 1: e^100 for one class over another is certainty enough
LEAST_TEMPERATURE = 0.01
SEARCH_FROM = (np.log(0.1), 0.4)


def fit_calibration(known: Vectors, labels: NDArray[np.intp], unknown: Vectors) -> Calibration:
    """known: (n, classes) held-out scores of labels, (n,); unknown: (m, classes or fewer), of classes left out.

    The known weigh 1 - NONE_PRIOR together, the unknown NONE_PRIOR. Raises ValueError without some
    of both.
    """
    if len(known) == 0 or len(unknown) == 0:
        raise ValueError("examples of known classes and of classes left out are needed")

    def loss(parameters: NDArray[np.float64]) -> float:
        calibration = _calibration(parameters)
        of_known, _ = _shares(known, calibration)
        _, of_none = _shares(unknown, calibration)
        right = of_known[np.arange(len(labels)), labels]
        of_known_loss = -(1.0 - NONE_PRIOR) * np.log(np.maximum(right, 1e-12)).mean()
        return float(of_known_loss - NONE_PRIOR * np.log(np.maximum(of_none, 1e-12)).mean())

    return _calibration(scipy.optimize.minimize(loss, SEARCH_FROM, method="Nelder-Mead").x)


def _calibration(parameters: NDArray[np.float64]) -> Calibration:
    """From log temperature and none score.

    Scores that part all classes would have a temperature of 0.
    """
    return Calibration(max(float(np.exp(parameters[0])), LEAST_TEMPERATURE), float(parameters[1]))


def _shares(scores: Vectors, calibration: Calibration) -> tuple[Vectors, NDArray[np.float64]]:
    likelihoods, none = calibration.log_likelihoods(scores)
    return posterior(likelihoods, none, np.full(scores.shape[1], -np.log(scores.shape[1])))


FOLDS = 10


def specimen_folds(
    labels: NDArray[np.intp], specimens: Sequence[str], folds: int = FOLDS, seed: int = 0
) -> list[NDArray[np.intp]]:
    """Rows held out together: each specimen in one fold, each class's specimens dealt out evenly.

    labels: (n,).
    """
    rng = np.random.default_rng(seed)
    names = np.asarray(specimens)
    fold_of: dict[str, int] = {}
    next_fold = 0
    for label in np.unique(labels):
        of_class = np.unique(names[labels == label])
        for name in rng.permutation(of_class):
            fold_of[str(name)] = next_fold % folds
            next_fold += 1
    number = np.array([fold_of[str(name)] for name in names])
    return [np.flatnonzero(number == fold) for fold in range(folds) if np.any(number == fold)]


def scores_of_unseen_specimens(
    examples: Vectors,
    labels: NDArray[np.intp],
    specimens: Sequence[str],
    classes: int,
    seed: int = 0,
) -> tuple[Vectors, NDArray[np.bool_]]:
    """(n, classes) scores, and (n,) whether another specimen of the class was there to know it by.

    examples: (n, d), embedded.
    """
    scores = np.zeros((len(examples), classes))
    for held in specimen_folds(labels, specimens, seed=seed):
        kept = np.setdiff1d(np.arange(len(examples)), held)
        scores[held] = KernelClassifier(examples[kept], labels[kept], classes).scores(
            examples[held]
        )
    names = np.asarray(specimens)
    counts = np.array([len(np.unique(names[labels == label])) for label in range(classes)])
    return scores, counts[labels] > 1


def scores_of_unseen_classes(examples: Vectors, labels: NDArray[np.intp], classes: int) -> Vectors:
    """(n, classes - 1): each example's scores by a classifier that never saw its class."""
    scores = np.zeros((len(examples), classes - 1))
    for left_out in range(classes):
        kept, held = np.flatnonzero(labels != left_out), np.flatnonzero(labels == left_out)
        others = labels[kept] - (labels[kept] > left_out)
        scores[held] = KernelClassifier(examples[kept], others, classes - 1).scores(examples[held])
    return scores
