"""What somebody is likely to eat: their own confirmed meals, the study's, and the time of day.

Each level gives way to the next as it gathers meals (hierarchical Dirichlet smoothing: MacKay and
Peto, "A hierarchical Dirichlet language model", Nat. Lang. Eng. 1(3), 1995): a participant's shares
are pulled to the study's, the study's to equal shares. A meal at about the same time of day counts
more than one at another.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Weights = NDArray[np.float64]

DAY_MINUTES = 1440
SAME_TIME_SD_MINUTES = 90.0
ANY_TIME = 0.35  # the weight of a meal at quite another time of day
STUDY_WEIGHT = 10.0  # the others' shares stand for so many of the participant's items
EQUAL_WEIGHT = 20.0  # equal shares stand for so many of the study's items
# what an item counts for that was eaten with a food which lies beside it now; a judgement
COMPANY = 3.0
USUAL = 2.0  # times the equal share, from which on a food is usual
# to begin with: an index of a few foods often meets others; a judgement
NEW_FOODS, NEW_OF = 6.0, 20.0


@dataclass(frozen=True, slots=True)
class Eaten:
    """A confirmed item: which food, and when, minutes after local midnight. beside: the other foods of its meal."""

    food_key: str
    day_minute: int
    beside: frozenset[str] = frozenset()


def time_weights(day_minute: int | None) -> Weights:
    """(DAY_MINUTES,) what a meal at each minute counts now.

    1 at the same time of day, ANY_TIME half a day apart; 1 where the time is not known.
    """
    if day_minute is None:
        return np.ones(DAY_MINUTES)
    apart = np.abs(day_minute - np.arange(DAY_MINUTES))
    apart = np.minimum(apart, DAY_MINUTES - apart)
    same = np.exp(-0.5 * (apart / SAME_TIME_SD_MINUTES) ** 2)
    return np.asarray(ANY_TIME + (1.0 - ANY_TIME) * same, np.float64)


def log_prior(own: Weights, study: Weights) -> Weights:
    """(foods,) natural logarithm of the share of each food; the shares add up to 1.

    own: (foods,) the participant's items of each food, by what they count
    study: (foods,) the others'. Own ones among these would count twice, and what somebody has not
        eaten yet would be as good as ruled out.
    """
    equal = EQUAL_WEIGHT / len(study)
    study_share = (study + equal) / (study.sum() + EQUAL_WEIGHT)
    share = (own + STUDY_WEIGHT * study_share) / (own.sum() + STUDY_WEIGHT)
    return np.asarray(np.log(share), np.float64)


def new_food_share(confirmed: Weights, is_known: NDArray[np.bool_]) -> float:
    """How often the next item will be a food that the index does not know.

    confirmed: (foods,) items of each food. is_known: (foods,) without them. The share of confirmed
    items whose food came up once only and was not known before (Good, "The population frequencies
    of species and the estimation of population parameters", Biometrika 40, 1953), with NEW_FOODS in
    NEW_OF to begin with.
    """
    once = np.count_nonzero((confirmed == 1.0) & ~is_known)
    return float((once + NEW_FOODS) / (confirmed.sum() + NEW_OF))
