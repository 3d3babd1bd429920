"""Which known food a region is: scores by kernel ridge classification, and the probabilities that follow from them.

Each class's membership (1 or 0) is regressed on likeness to the examples: Saunders, Gammerman and
Vovk, "Ridge regression learning algorithm in dual variables", ICML 1998, with the Gaussian kernel;
for classes it is, but for its bias, the machine of Suykens and Vandewalle, "Least squares support
vector machine classifiers", Neural Process. Lett. 9(3), 1999. It is solved for each region anew,
from its nearest examples alone (Bottou and Vapnik, "Local learning algorithms", Neural Comput.
4(6), 1992): there is no training, and a confirmed item joins by being there. A class of five
examples stands beside one of seventy: each example's noise grows with the root of its class's size,
and scores are raised by what a small class is known to lack.

p(class) ~ prior(class) exp(score / temperature), p(none) ~ prior(none) exp(none_score /
temperature): temperature scaling (Guo, Pleiss, Sun and Weinberger, "On calibration of modern neural
networks", ICML 2017) with one more class, "none of these", whose score is the same for all regions.
Both numbers come with the index (build_index.py fits them).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.identification.metric import Vectors, squared_distances

WIDTH = 1.0  # of the kernel, exp(-WIDTH d²), where typical regions are d = 1 apart
RIDGE = 0.03  # the share of an example's membership that counts as noise
MISSING = 2.0  # a class of n examples scores some n / (n + MISSING) of what it will: ECUSTFD's foods, some left out
# examples that decide: with all of two thousand, no more foods are told (decision 0068)
NEAREST = 256


@dataclass(frozen=True, slots=True)
class KernelClassifier:
    """examples: (n, d) embedded, n >= 1; labels: (n,) in 0..classes - 1."""

    examples: Vectors
    labels: NDArray[np.intp]
    classes: int

    def scores(self, embedded: Vectors) -> Vectors:
        """(m, d) -> (m, classes): near 1 for the class whose examples are all around, near 0 far from a class's."""
        return np.stack([self._scores(row) for row in likeness(embedded, self.examples)])

    def _scores(self, likely: Vectors) -> Vectors:
        """(classes,) of one region, by its likeness to each example, (n,)."""
        near = np.argpartition(-likely, min(NEAREST, len(likely)) - 1)[:NEAREST]
        present, labels = np.unique(self.labels[near], return_inverse=True)
        kernel = likeness(self.examples[near], self.examples[near])
        kernel[np.diag_indices_from(kernel)] += RIDGE * _noise(labels)
        shares = np.bincount(labels, np.linalg.solve(kernel, likely[near]))
        scores = np.zeros(self.classes)
        scores[present] = shares * _raised(labels)
        return scores


def likeness(a: Vectors, b: Vectors) -> Vectors:
    """(n, m) Gaussian kernel: 1 for the same, 0 for what has nothing in common."""
    return np.asarray(np.exp(-WIDTH * squared_distances(a, b)), np.float64)


def _raised(labels: NDArray[np.intp]) -> Vectors:
    """(classes,) what each class's scores are multiplied by."""
    counts = np.bincount(labels).astype(np.float64)
    return np.asarray((counts + MISSING) / counts, np.float64)


def _noise(labels: NDArray[np.intp]) -> Vectors:
    """(n,) root of the size of each example's class, 1 on average: no class outweighs another by its number alone."""
    roots = np.sqrt(np.bincount(labels)[labels].astype(np.float64))
    return np.asarray(roots / roots.mean(), np.float64)


NONE_PRIOR = 0.05  # of a food that the index does not know, where it is asked about those it may know; a judgement


@dataclass(frozen=True, slots=True)
class Calibration:
    """temperature > 0; none_score: on the scores' scale."""

    temperature: float
    none_score: float

    def log_likelihoods(self, scores: Vectors) -> tuple[Vectors, float]:
        """(n, classes) scores -> log likelihoods of the classes, and of none of them, up to one constant."""
        return scores / self.temperature, self.none_score / self.temperature


def posterior(
    log_likelihoods: Vectors,
    none_log_likelihood: float,
    log_prior: Vectors,
    none_prior: float = NONE_PRIOR,
) -> tuple[Vectors, NDArray[np.float64]]:
    """(n, classes) probabilities and (n,) of none of them; a row and its none add up to 1.

    log_prior: (classes,) or (n, classes), of the classes among themselves
    none_prior: between 0 and 1
    """
    known = log_likelihoods + log_prior + np.log1p(-none_prior)
    none = np.full((len(known), 1), none_log_likelihood + np.log(none_prior))
    joint = np.concatenate([known, none], axis=1)
    weights = np.exp(joint - joint.max(axis=1, keepdims=True))
    shares = weights / weights.sum(axis=1, keepdims=True)
    return shares[:, :-1], shares[:, -1]
