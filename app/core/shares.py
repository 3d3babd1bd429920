"""How sure a share of a count is."""

import math


def wilson_interval(share: float, count: int, z: float) -> tuple[float, float]:
    """Return the interval of a binomial share. z: of the normal distribution, 1.96 for 95 %.

    E. B. Wilson, Journal of the American Statistical Association 22 (1927) 209.
    """
    scale = 1 + z**2 / count
    middle = (share + z**2 / (2 * count)) / scale
    half = z / scale * math.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return middle - half, middle + half
