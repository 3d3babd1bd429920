"""How likely a measured volume is for each food.

Volumes of a food are taken as log-normal, from the shipped index and the items that a study has confirmed. A slice of
a food, or two pieces, is always possible, so no size rules a food out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

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


def food_size(volumes_ml: Sequence[float]) -> FoodSize | None:
    """Return the size of a food's next piece from measured pieces, ml; None without any. 0 and NaN are left out.

    The spread is shrunk towards OWN_LOG_SD and widened by the doubt about the mean: the scaled inverse chi-squared
    prior of Gelman et al., Bayesian Data Analysis, 3.3, with a flat one of the mean, and a normal for the t.
    """
    logs = [math.log(volume) for volume in volumes_ml if 0.0 < volume < math.inf]
    if not logs:
        return None
    count = len(logs)
    mean = sum(logs) / count
    squares = sum((log - mean) ** 2 for log in logs)
    variance = (OWN_WEIGHT * OWN_LOG_SD**2 + squares) / (OWN_WEIGHT + count - 1)
    return FoodSize(mean, math.sqrt(variance * (1.0 + 1.0 / count)))


def size_log_likelihood(
    size: FoodSize | None, volume_ml: float | None, relative_sd: float = 0.0
) -> float:
    """Return the log likelihood ratio of this volume, the food against any food; 0 where either is not known.

    relative_sd: of the measurement. At least log(1 - AS_EXPECTED); 0 for values that are not finite.
    """
    if (
        size is None
        or volume_ml is None
        or not (0.0 < volume_ml < math.inf and math.isfinite(relative_sd))
    ):
        return 0.0
    value = math.log(volume_ml)
    of_any = _log_density(value, ANY_LOG_ML, math.hypot(ANY_LOG_SD, relative_sd))
    of_food = _log_density(value, size.log_mean, math.hypot(size.log_sd, relative_sd))
    return math.log(AS_EXPECTED * math.exp(min(of_food - of_any, 50.0)) + 1.0 - AS_EXPECTED)


def _log_density(value: float, mean: float, sd: float) -> float:
    return -0.5 * ((value - mean) / sd) ** 2 - math.log(sd)
