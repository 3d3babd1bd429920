"""How well an index identifies what it has not seen: whole specimens held out, and whole classes.

Pictures of one specimen are far more alike than two specimens are, so that they are held out together.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.identification.kernel_classifier import fit_classifier
from app.identification.metric import Vectors

FOLDS = 10


def specimen_folds(
    labels: NDArray[np.intp], specimens: Sequence[str], folds: int = FOLDS, seed: int = 0
) -> list[NDArray[np.intp]]:
    """Rows held out together: each specimen in one fold, each class's specimens dealt out evenly. labels: (n,)."""
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
        scores[held] = fit_classifier(examples[kept], labels[kept], classes).scores(examples[held])
    names = np.asarray(specimens)
    counts = np.array([len(np.unique(names[labels == label])) for label in range(classes)])
    return scores, counts[labels] > 1


def scores_of_unseen_classes(examples: Vectors, labels: NDArray[np.intp], classes: int) -> Vectors:
    """(n, classes - 1): each example's scores by a classifier that never saw its class."""
    scores = np.zeros((len(examples), classes - 1))
    for left_out in range(classes):
        kept, held = np.flatnonzero(labels != left_out), np.flatnonzero(labels == left_out)
        others = labels[kept] - (labels[kept] > left_out)
        scores[held] = fit_classifier(examples[kept], others, classes - 1).scores(examples[held])
    return scores
