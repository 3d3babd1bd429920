"""What somebody is likely to eat: their own confirmed meals, the study's, and the time of day.

Each level gives way to the next as it gathers meals (hierarchical Dirichlet smoothing: MacKay and
Peto, "A hierarchical Dirichlet language model", Nat. Lang. Eng. 1(3), 1995): a participant's shares
are pulled to the study's, the study's to equal shares. A meal at about the same time of day counts
more than one at another.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

DAY_MINUTES = 1440
SAME_TIME_SD_MINUTES = 90.0
ANY_TIME = 0.35  # the weight of a meal at quite another time of day
STUDY_WEIGHT = 10.0  # the others' shares stand for so many of the participant's items
EQUAL_WEIGHT = 20.0  # equal shares stand for so many of the study's items
NEW_FOODS, NEW_OF = (
    6.0,
    20.0,
)  # to begin with: an index of a few foods often meets others; a judgement


@dataclass(frozen=True, slots=True)
class Eaten:
    """A confirmed item: which food, and when, minutes after local midnight."""

    food_key: str
    day_minute: int


def log_prior(
    foods: Sequence[str], day_minute: int | None, own: Sequence[Eaten], study: Sequence[Eaten]
) -> list[float]:
    """Natural logarithm of the share of each food, in their order; they add up to 1.

    own: the participant's items
    study: the others'. Own ones among these would count twice, and what somebody has not eaten yet
        would be as good as ruled out.
    """
    known = set(foods)
    of_study = _weights(known, day_minute, study)
    of_own = _weights(known, day_minute, own)
    all_of_study, all_of_own = sum(of_study.values()), sum(of_own.values())
    out = []
    for food in foods:
        study_share = (of_study.get(food, 0.0) + EQUAL_WEIGHT / len(foods)) / (
            all_of_study + EQUAL_WEIGHT
        )
        share = (of_own.get(food, 0.0) + STUDY_WEIGHT * study_share) / (all_of_own + STUDY_WEIGHT)
        out.append(math.log(share))
    return out


def new_food_share(known_before: frozenset[str], confirmed: Sequence[str]) -> float:
    """How often the next item will be a food that the index does not know.

    The share of confirmed items whose food came up once only and was not known before (Good, "The
    population frequencies of species and the estimation of population parameters", Biometrika 40,
    1953), with NEW_FOODS in NEW_OF to begin with.
    """
    counts: dict[str, int] = {}
    for food in confirmed:
        counts[food] = counts.get(food, 0) + 1
    once = sum(count == 1 for food, count in counts.items() if food not in known_before)
    return (once + NEW_FOODS) / (len(confirmed) + NEW_OF)


def _weights(
    known: set[str], day_minute: int | None, eaten: Sequence[Eaten]
) -> Mapping[str, float]:
    weights: dict[str, float] = {}
    for item in eaten:
        if item.food_key in known:
            weights[item.food_key] = weights.get(item.food_key, 0.0) + _weight(
                day_minute, item.day_minute
            )
    return weights


def _weight(now: int | None, then: int) -> float:
    """1 at the same time of day, ANY_TIME half a day apart; 1 where the time is not known."""
    if now is None:
        return 1.0
    apart = abs(now - then) % DAY_MINUTES
    apart = min(apart, DAY_MINUTES - apart)
    return ANY_TIME + (1.0 - ANY_TIME) * math.exp(-0.5 * (apart / SAME_TIME_SD_MINUTES) ** 2)
