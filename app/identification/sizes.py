"""What sizes say: which food an item may be, and whether the marker has the size that was declared.

Volumes of a food are taken as log-normal, from the shipped index and the items that a study has
confirmed. A slice of a food, or two pieces, is always possible, so no size rules a food out.

A board declared at twice its size makes plates of half a metre and apples of a litre and a half.
Round dishes and foods of known kinds say by Bayes' rule which factor all lengths should have: 1,
within the error of a printer, or any other.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Log = NDArray[np.float64]

ANY_LOG_ML, ANY_LOG_SD = math.log(150.0), 1.1  # of foods on plates at large: 17 to 1,300 ml in 95 %
# between pieces of one food, until its own pieces tell; ECUSTFD's foods have 0.1 to 0.6
OWN_LOG_SD = 0.5
OWN_WEIGHT = 2.0  # pieces that this stands for
AS_EXPECTED = 0.8  # of items: one whole piece, as those that are known; the others are cut, several, or half eaten


@dataclass(frozen=True, slots=True)
class FoodSize:
    """log ml of the food's next piece: mean and standard deviation."""

    log_mean: float
    log_sd: float


def log_volume(volume_ml: float | None) -> float:
    """Return log ml; NaN for what is no volume."""
    return math.log(volume_ml) if volume_ml is not None and 0.0 < volume_ml < math.inf else math.nan


def food_sizes(counts: Log, sums: Log, squares: Log) -> tuple[Log, Log]:
    """(n,) mean and standard deviation of the log volume of each food's next piece; NaN without any piece.

    counts, sums, squares: (n,) number, sum and sum of squares of the log volumes of its measured
    pieces. The spread is shrunk towards OWN_LOG_SD and widened by the doubt about the mean: the
    scaled inverse chi-squared prior of Gelman et al., Bayesian Data Analysis, 3.3, with a flat one
    of the mean, and a normal for the t.
    """
    pieces = np.where(counts > 0.0, counts, np.nan)
    means = sums / pieces
    around = np.maximum(squares - sums * means, 0.0)
    variances = (OWN_WEIGHT * OWN_LOG_SD**2 + around) / (OWN_WEIGHT + pieces - 1)
    return means, np.sqrt(variances * (1.0 + 1.0 / pieces))


def size_log_likelihoods(
    log_means: Log, log_sds: Log, volume_ml: float | None, relative_sd: float = 0.0
) -> Log:
    """Return the (n,) log likelihood ratio of this volume, each food against any; 0 where either is not known.

    relative_sd: of the measurement. At least log(1 - AS_EXPECTED); 0 for values that are not
    finite.
    """
    value = log_volume(volume_ml)
    if not (math.isfinite(value) and math.isfinite(relative_sd)):
        return np.zeros_like(log_means)
    of_any = _log_normal(value, ANY_LOG_ML, math.hypot(ANY_LOG_SD, relative_sd))
    of_foods = _log_normal(value, log_means, np.hypot(log_sds, relative_sd))
    ratios = np.log(AS_EXPECTED * np.exp(np.minimum(of_foods - of_any, 50.0)) + 1.0 - AS_EXPECTED)
    return np.nan_to_num(ratios, nan=0.0)


SIZE_TELLS = math.log(1.5)  # log likelihood ratio from which on a size is told as a reason


LOG_FACTORS = np.linspace(-1.6, 1.6, 321)  # of lengths: a fifth to five times
# of studies' boards; of a printer that scales to the page
DECLARED_RIGHT, PRINT_LOG_SD = 0.95, 0.03
WRONG_LOG_SD = 0.7  # a factor of two either way is usual among wrong ones: millimetres of another board, inches, A3
# Median, mm, and spread in logarithms. Rims' radii: plates of 170 mm across to platters of 330, bowls of 110 to 240,
# espresso cups of 55 to mugs of 115, in 90 % of tableware. Phones are held 210 to 680 mm above the table.
USUAL_MM = {
    "plate": (120.0, 0.2),
    "bowl": (80.0, 0.25),
    "cup": (40.0, 0.22),
    "camera": (380.0, 0.35),
}
UNUSUAL, UNUSUAL_LOG_SD = 0.1, 0.7  # share of other sizes, and their spread
SURE = 0.7  # posterior from which on the factor is told: the sizes are some 45 times likelier with another one
# of a factor that is told: below it the interval of a volume covers much of it
LEAST_LOG_FACTOR = math.log(1.2)


@dataclass(frozen=True, slots=True)
class MeasuredFood:
    """volume_ml: with its relative standard deviation.

    kinds: (probability, size) of the foods that it may be.

    What is left of the probabilities is for a food of which no size is known.
    """

    volume_ml: float
    relative_sd: float = 0.0
    kinds: Sequence[tuple[float, FoodSize]] = ()


def plausible_factor(
    lengths_mm: Mapping[str, Sequence[float]], foods: Sequence[MeasuredFood]
) -> float | None:
    """Return the factor that all lengths should have; None unless the declared size is clearly not the right one.

    lengths_mm: kind, as in USUAL_MM -> radii of rims, the camera's height.
    """
    right = math.log(DECLARED_RIGHT) + _log_normal(LOG_FACTORS, 0.0, PRINT_LOG_SD)
    wrong = math.log(1.0 - DECLARED_RIGHT) + _log_normal(LOG_FACTORS, 0.0, WRONG_LOG_SD)
    likelihood = np.zeros_like(LOG_FACTORS)
    # dishes of one kind are of one set: they count once
    for kind, of_kind_mm in lengths_mm.items():
        likelihood += np.mean(
            [_length_log_likelihood(kind, length_mm) for length_mm in of_kind_mm], axis=0
        )
    if foods:  # that all are small, or large, counts once; what each kind says, for itself
        likelihood += np.mean([_of_any_food(food) for food in foods], axis=0)
        likelihood += np.sum([_of_its_kind(food) for food in foods], axis=0)
    log_posterior = np.logaddexp(right, wrong) + likelihood
    posterior = np.exp(log_posterior - np.max(log_posterior))
    posterior /= posterior.sum()
    is_other = np.abs(LOG_FACTORS) > LEAST_LOG_FACTOR
    if posterior[is_other].sum() < SURE:
        return None
    return float(np.exp(LOG_FACTORS[np.searchsorted(np.cumsum(posterior), 0.5)]))


def _length_log_likelihood(kind: str, length_mm: float) -> Log:
    """(n,) of each factor. Some are unusual: sauce dishes, platters, a phone at arm's length."""
    logs = math.log(length_mm) + LOG_FACTORS
    usual_mm, log_sd = USUAL_MM[kind]
    usual = np.exp(_log_normal(logs, math.log(usual_mm), log_sd))
    unusual = np.exp(_log_normal(logs, math.log(usual_mm), UNUSUAL_LOG_SD))
    return np.asarray(np.log((1.0 - UNUSUAL) * usual + UNUSUAL * unusual))


def _of_any_food(food: MeasuredFood) -> Log:
    """(n,) of each factor, for a food of whatever kind."""
    logs = math.log(food.volume_ml) + 3.0 * LOG_FACTORS
    return _log_normal(logs, ANY_LOG_ML, math.hypot(ANY_LOG_SD, food.relative_sd))


def _of_its_kind(food: MeasuredFood) -> Log:
    """(n,) what its kind adds.

    A slice, or several pieces, may have any size, as for the identification (sizes.py).
    """
    logs, share = math.log(food.volume_ml) + 3.0 * LOG_FACTORS, 0.0
    of_kinds = np.zeros_like(logs)
    for probability, size in food.kinds:
        of_kinds += probability * np.exp(
            _log_normal(logs, size.log_mean, math.hypot(size.log_sd, food.relative_sd))
        )
        share += probability
    return np.asarray(
        np.log(AS_EXPECTED * of_kinds / np.exp(_of_any_food(food)) + 1.0 - AS_EXPECTED * share)
    )


def _log_normal(value: Log | float, mean: Log | float, sd: Log | float) -> Log:
    return np.asarray(-0.5 * ((value - mean) / sd) ** 2 - np.log(sd))
