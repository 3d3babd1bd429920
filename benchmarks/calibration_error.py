"""How honest probabilities are."""

import numpy as np
from numpy.typing import NDArray

BINS = 15


def expected_calibration_error(
    probabilities: NDArray[np.float64], is_right: NDArray[np.bool_], bins: int = BINS
) -> float:
    """Mean |share right - mean probability| over equal bins of the first candidate's probability, (n,), by size.

    Naeini, Cooper and Hauskrecht, "Obtaining well calibrated probabilities using Bayesian binning", AAAI 2015. Raises
    ValueError without any.
    """
    if len(probabilities) == 0:
        raise ValueError("no probability is no calibration")
    place = np.minimum((probabilities * bins).astype(int), bins - 1)
    gaps = [
        np.count_nonzero(place == i)
        * abs(is_right[place == i].mean() - probabilities[place == i].mean())
        for i in np.unique(place)
    ]
    return float(np.sum(gaps) / len(probabilities))
