"""Groups of foods as candidates: what an item surely is where no single food is likely enough.

A group is a food of the starter table, with the mean figures of its members and a spread that
covers them (docs/food-table.md).
"""

from collections.abc import Mapping
from functools import cache

from app.identification.identifier import Candidate, Identification
from app.meals.stored.run_answer import SURE_FROM, CandidateAnswer
from app.nutrition.foods import load_starter_table

GROUP_FROM = 0.5  # of a group that is offered
LEAST_ADDED = 0.1  # by the other foods of a group: else it says no more than its likeliest one
DECIMALS = 6


def candidate_answers(identification: Identification) -> list[CandidateAnswer]:
    """Return the foods, and the groups that say more than they do, best first."""
    foods = [_answer(food) for food in identification.candidates]
    best = foods[0].probability if foods else 1.0
    if best >= SURE_FROM:
        return foods
    groups = [
        _answer(group, is_group=True)
        for group in identification.groups
        if group.probability >= max(GROUP_FROM, best + LEAST_ADDED)
    ]
    return [*groups, *foods]


@cache
def groups_of_foods() -> Mapping[str, frozenset[str]]:
    """Return the starter table's groups: key -> its members' keys."""
    return {
        food.key: frozenset(food.members) for food in load_starter_table().foods if food.members
    }


def _answer(candidate: Candidate, *, is_group: bool = False) -> CandidateAnswer:
    return CandidateAnswer(
        food=candidate.food_key,
        probability=round(candidate.probability, DECIMALS),
        specimens=candidate.specimens,
        is_group=is_group,
        reasons=list(candidate.reasons),
    )
