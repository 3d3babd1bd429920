"""Assign foods to the groups of dietary recommendations; total grams by group; judge whether a recommendation is met.

Food tables group by trade, recommendations by nutrition: SR28 lists potatoes among the vegetables, juices among the
fruit, peanuts among the legumes, butter and eggs among the dairy products. The rules below match SR28's group and name.
A food that no rule assigns with certainty (a mixed dish, a breaded or sweetened one, a group of another table) is
unassigned: its grams are reported, and a recommendation that they could decide stays open.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Literal, get_args

from app.nutrition.foods import Food
from app.nutrition.intakes.life_stage import check_age
from app.nutrition.packaged_rows import packaged_rows

FoodGroup = Literal[
    "fruit", "fruit_juice", "dried_fruit", "vegetables", "vegetable_juice", "starchy_tubers", "legumes", "soy", "nuts",
    "grains", "milk", "cheese", "eggs", "beef_lamb", "pork", "poultry", "fish", "processed_meat", "dairy_fat",
    "palm_oil", "unsaturated_oils", "lard_tallow", "sugars", "beverages",
]  # fmt: skip
Basis = Literal["as_eaten", "dry", "milk_equivalent"]
Verdict = Literal["met", "not_met", "open"]

FOOD_GROUPS: tuple[FoodGroup, ...] = get_args(FoodGroup)
BASES: tuple[Basis, ...] = get_args(Basis)

# Preparations after which the grams are no longer those of the food itself.
_DISH = r"breaded|battered|au gratin|scalloped|souffle|(?<!corn)salad|sauce|gravy|candied|creamed|stuffed"
_TUBERS = r"^(sweet )?potato|^cassava|^(mountain )?yam\b|^taro\b|^yautia|^poi\b|^arrowhead|^winged bean tuber"


@dataclass(frozen=True, slots=True)
class Eaten:
    """A food and the edible grams eaten of it; None if the mass is not known."""

    food: Food
    edible_g: float | None


@dataclass(frozen=True, slots=True)
class GroupTotals:
    """Grams by group. unassigned_g: food key -> grams in no group. unmeasured: foods whose mass is not known."""

    grams: Mapping[FoodGroup, float]
    unassigned_g: Mapping[str, float]
    unmeasured: int

    @property
    def unassigned_share(self) -> float | None:
        """Return the share (0 to 1) of the known mass that is in no group; None if no mass is known."""
        unassigned_g = sum(self.unassigned_g.values())
        total_g = unassigned_g + sum(self.grams.values())
        return unassigned_g / total_g if total_g > 0.0 else None


@dataclass(frozen=True, slots=True)
class Recommendation:
    """Grams per day of one or several groups together: at least low_g, at most high_g, target_g in the source's diet.

    basis: what the grams refer to; only those of food as eaten compare with what a camera sees. note: caveats.
    """

    source: str
    name: str
    groups: tuple[FoodGroup, ...]
    low_g: float | None
    target_g: float | None
    high_g: float | None
    basis: Basis
    note: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """A recommendation and the grams eaten per day. verdict: open if it cannot be decided; `reason` then says why."""

    recommendation: Recommendation
    grams_per_day: float
    verdict: Verdict
    reason: str


def food_group_of(food: Food) -> FoodGroup | None:
    """Return the group of a food, or None (unassigned). Uses SR28's name of the food if the food has it."""
    if food.is_mixed_dish:
        return None
    return classify(food.food_group, food.source_ids.get("sr28_name", food.name))


def classify(source_group: str, name: str) -> FoodGroup | None:
    """Return the recommendations' group of SR28's food group and name; None if no rule assigns it with certainty."""
    return next((group for pattern, group in _rules().get(source_group, ()) if pattern.search(name.casefold())), None)


def total_groups(eaten: Sequence[Eaten]) -> GroupTotals:
    """Return the grams by group of everything eaten; every gram is in a group or unassigned."""
    grams: dict[FoodGroup, float] = {}
    unassigned_g: dict[str, float] = {}
    for portion in eaten:
        if portion.edible_g is None:
            continue
        group = food_group_of(portion.food)
        if group is None:
            unassigned_g[portion.food.key] = unassigned_g.get(portion.food.key, 0.0) + portion.edible_g
        else:
            grams[group] = grams.get(group, 0.0) + portion.edible_g
    unmeasured = sum(portion.edible_g is None for portion in eaten)
    return GroupTotals(MappingProxyType(grams), MappingProxyType(unassigned_g), unmeasured)


def recommendations(age_years: float) -> tuple[Recommendation, ...]:
    """Return the recommendations for this age: WHO from 2 years, EAT-Lancet for adults. Raises ValueError."""
    check_age(age_years)
    return tuple(
        recommendation for from_years, below_years, recommendation in _all() if from_years <= age_years < below_years
    )


def compare(totals: GroupTotals, recommendation: Recommendation, days: float) -> Comparison:
    """Compare what was eaten over `days` days with a recommendation.

    Unassigned grams and unmeasured foods may belong to the group, so the verdict is "met" or "not_met" only if it holds
    either way. Raises ValueError if days is not positive.
    """
    if not 0.0 < days < math.inf:
        raise ValueError(f"a comparison needs a number of days above 0, not {days}")
    known_g = sum(totals.grams.get(group, 0.0) for group in recommendation.groups) / days
    if recommendation.basis != "as_eaten":
        reason = f"the recommendation is in grams {recommendation.basis.replace('_', ' ')}, the food in grams as eaten"
        return Comparison(recommendation, known_g, "open", reason)
    most_g = math.inf if totals.unmeasured else known_g + sum(totals.unassigned_g.values()) / days
    low_g = 0.0 if recommendation.low_g is None else recommendation.low_g
    high_g = math.inf if recommendation.high_g is None else recommendation.high_g
    if most_g < low_g or known_g > high_g:
        return Comparison(recommendation, known_g, "not_met", "")
    if known_g >= low_g and most_g <= high_g:
        return Comparison(recommendation, known_g, "met", "")
    reason = "foods of unknown mass may decide it" if totals.unmeasured else "food in no group may decide it"
    return Comparison(recommendation, known_g, "open", reason)


@cache
def _rules() -> Mapping[str, Sequence[tuple[re.Pattern[str], FoodGroup | None]]]:
    """Return SR28 food group -> (pattern of the name, group): the first match counts; None: unassigned."""
    rules: dict[str, list[tuple[re.Pattern[str], FoodGroup | None]]] = {}
    for row in packaged_rows("reference", "food_group_rules.csv"):
        pattern = re.compile(row["pattern"].format(dish=_DISH, tubers=_TUBERS))
        group = next((group for group in FOOD_GROUPS if group == row["group"]), None)
        rules.setdefault(row["source_group"], []).append((pattern, group))
    return rules


@cache
def _all() -> tuple[tuple[float, float, Recommendation], ...]:
    return tuple(
        (float(row["from_years"]), float(row["below_years"] or "inf"), _recommendation(row))
        for row in packaged_rows("reference", "food_group_recommendations.csv")
    )


def _recommendation(row: Mapping[str, str]) -> Recommendation:
    return Recommendation(
        source=row["source"],
        name=row["name"],
        groups=tuple(group for group in FOOD_GROUPS if group in row["groups"].split()),
        low_g=float(row["low_g"]) if row["low_g"] else None,
        target_g=float(row["target_g"]) if row["target_g"] else None,
        high_g=float(row["high_g"]) if row["high_g"] else None,
        basis=next(basis for basis in BASES if basis == row["basis"]),
        note=row["note"],
    )
