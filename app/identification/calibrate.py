"""Scores into probabilities: a temperature, and the score that stands for "none of these".

p(class) ~ prior(class) exp(score / temperature), p(none) ~ prior(none) exp(none_score / temperature): temperature
scaling (Guo, Pleiss, Sun and Weinberger, "On calibration of modern neural networks", ICML 2017) with one class
more whose score is the same for all regions, so that it wins where nothing known scores well. Both numbers are those
under which held-out examples are likeliest: of known classes, no picture of whose specimen was seen; and of classes
that were left out whole, which stand for all that the index does not know.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from app.identification.metric import Vectors

NONE_PRIOR = 0.05  # of a food that the index does not know, where it is asked about those it may know; a judgement
LEAST_TEMPERATURE = 0.01  # of scores that run from 0 to 1: e^100 for one class over another is certainty enough
BINS = 15
SEARCH_FROM = (np.log(0.1), 0.4)


@dataclass(frozen=True, slots=True)
class Calibration:
    """temperature > 0; none_score: on the scores' scale."""

    temperature: float
    none_score: float

    def log_likelihoods(self, scores: Vectors) -> tuple[Vectors, float]:
        """(n, classes) scores -> log likelihoods of the classes, and of none of them, up to one constant."""
        return scores / self.temperature, self.none_score / self.temperature


def posterior(
    log_likelihoods: Vectors, none_log_likelihood: float, log_prior: Vectors, none_prior: float = NONE_PRIOR
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


def fit_calibration(known: Vectors, labels: NDArray[np.intp], unknown: Vectors) -> Calibration:
    """known: (n, classes) held-out scores of labels, (n,); unknown: (m, classes or fewer), of classes left out.

    The known weigh 1 - NONE_PRIOR together, the unknown NONE_PRIOR. Raises ValueError without some of both.
    """
    if len(known) == 0 or len(unknown) == 0:
        raise ValueError("examples of known classes and of classes left out are needed")

    def loss(parameters: NDArray[np.float64]) -> float:
        calibration = _calibration(parameters)
        of_known, _ = _shares(known, calibration)
        _, of_none = _shares(unknown, calibration)
        right = of_known[np.arange(len(labels)), labels]
        told = -(1.0 - NONE_PRIOR) * np.log(np.maximum(right, 1e-12)).mean()
        return float(told - NONE_PRIOR * np.log(np.maximum(of_none, 1e-12)).mean())

    found = minimize(loss, SEARCH_FROM, method="Nelder-Mead")
    return _calibration(found.x)


def expected_calibration_error(probabilities: Vectors, is_right: NDArray[np.bool_], bins: int = BINS) -> float:
    """Mean |share right - mean probability| over equal bins of the first candidate's probability, (n,), by size.

    Naeini, Cooper and Hauskrecht, "Obtaining well calibrated probabilities using Bayesian binning", AAAI 2015. Raises
    ValueError without any.
    """
    if len(probabilities) == 0:
        raise ValueError("no probability is no calibration")
    place = np.minimum((probabilities * bins).astype(int), bins - 1)
    gaps = [
        np.count_nonzero(place == i) * abs(is_right[place == i].mean() - probabilities[place == i].mean())
        for i in np.unique(place)
    ]
    return float(np.sum(gaps) / len(probabilities))


def _calibration(parameters: NDArray[np.float64]) -> Calibration:
    """From log temperature and none score. Scores that part all classes would have a temperature of 0."""
    return Calibration(max(float(np.exp(parameters[0])), LEAST_TEMPERATURE), float(parameters[1]))


def _shares(scores: Vectors, calibration: Calibration) -> tuple[Vectors, NDArray[np.float64]]:
    likelihoods, none = calibration.log_likelihoods(scores)
    return posterior(likelihoods, none, np.full(scores.shape[1], -np.log(scores.shape[1])))
