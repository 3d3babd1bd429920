"""Scores into probabilities: a temperature, and the score that stands for "none of these".

p(class) ~ prior(class) exp(score / temperature), p(none) ~ prior(none) exp(none_score / temperature): temperature
scaling (Guo, Pleiss, Sun and Weinberger, "On calibration of modern neural networks", ICML 2017) with one class
more whose score is the same for all regions, so that it wins where nothing known scores well. Both numbers come with
the index (building/fit_calibration.py fits them).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.identification.metric import Vectors

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

    log_prior: (classes,) or (n, classes), of the classes among themselves. none_prior: between 0 and 1.
    """
    known = log_likelihoods + log_prior + np.log1p(-none_prior)
    none = np.full((len(known), 1), none_log_likelihood + np.log(none_prior))
    joint = np.concatenate([known, none], axis=1)
    weights = np.exp(joint - joint.max(axis=1, keepdims=True))
    shares = weights / weights.sum(axis=1, keepdims=True)
    return shares[:, :-1], shares[:, -1]
