"""Edible grams to nutrients: amounts of one item, totals over items with the share of the mass that they cover.

What the table does not know is absent, never 0: a total says for how much of the edible mass its figure is known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from app.nutrition.components import COMPONENT_BY_TAGNAME
from app.nutrition.doubt import Estimate, Term, combine
from app.nutrition.foods import Food
from app.nutrition.mass import Mass
from app.units import content_of_mass


@dataclass(frozen=True, slots=True)
class Portion:
    """One item in a total. pair: names its pair of photographs, whose doubt is shared. sign: -1 for what was left."""

    food: Food
    mass: Mass
    pair: str
    sign: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class NutrientTotal:
    """A total in its component's unit, and the share (0 to 1) of the edible mass for which the content is known."""

    amount: Estimate
    coverage: float


def nutrient_amounts(food: Food, mass: Mass) -> Mapping[str, Estimate]:
    """Tagname -> amount in the item's edible mass, with its interval, in the component's unit; unknown ones absent."""
    return MappingProxyType(
        {
            tagname: mass.edible_g.scaled(content_of_mass(per_100_g, 1.0))
            for tagname, per_100_g in food.per_100_g.items()
        }
    )


def total_nutrients(portions: Sequence[Portion]) -> Mapping[str, NutrientTotal]:
    """Tagname -> total over the portions, for each component that at least one of them knows; in the table's order."""
    totals = {}
    whole_g = sum(portion.mass.edible_g.value for portion in portions)
    for tagname in COMPONENT_BY_TAGNAME:
        known = [portion for portion in portions if tagname in portion.food.per_100_g]
        if known:
            covered_g = sum(portion.mass.edible_g.value for portion in known)
            totals[tagname] = NutrientTotal(combine([_term(p, tagname) for p in known]), covered_g / whole_g)
    return MappingProxyType(totals)


def total_mass(portions: Sequence[Portion]) -> Estimate:
    """Edible grams of all portions together, with the interval."""
    return combine([_edible_term(portion, portion.mass.edible_g.value) for portion in portions])


def _term(portion: Portion, tagname: str) -> Term:
    return _edible_term(portion, content_of_mass(portion.food.per_100_g[tagname], portion.mass.edible_g.value))


def _edible_term(portion: Portion, value: float) -> Term:
    return Term(value, portion.mass.doubt, portion.pair, portion.food.key, portion.sign)
