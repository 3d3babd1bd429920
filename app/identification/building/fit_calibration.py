"""Fit the temperature and the none score of an index.

Both numbers are those under which held-out examples are likeliest: of known classes, no picture of whose specimen was
seen; and of classes that were left out whole, which stand for all that the index does not know.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from app.identification.calibrate import NONE_PRIOR, Calibration, posterior
from app.identification.metric import Vectors

# of scores that run from 0 to 1: e^100 for one class over another is certainty enough
LEAST_TEMPERATURE = 0.01
SEARCH_FROM = (np.log(0.1), 0.4)


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
        of_known_loss = -(1.0 - NONE_PRIOR) * np.log(np.maximum(right, 1e-12)).mean()
        return float(of_known_loss - NONE_PRIOR * np.log(np.maximum(of_none, 1e-12)).mean())

    return _calibration(scipy.optimize.minimize(loss, SEARCH_FROM, method="Nelder-Mead").x)


def _calibration(parameters: NDArray[np.float64]) -> Calibration:
    """From log temperature and none score. Scores that part all classes would have a temperature of 0."""
    return Calibration(max(float(np.exp(parameters[0])), LEAST_TEMPERATURE), float(parameters[1]))


def _shares(scores: Vectors, calibration: Calibration) -> tuple[Vectors, NDArray[np.float64]]:
    likelihoods, none = calibration.log_likelihoods(scores)
    return posterior(likelihoods, none, np.full(scores.shape[1], -np.log(scores.shape[1])))
