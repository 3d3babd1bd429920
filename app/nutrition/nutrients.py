"""Edible grams to nutrients: amounts of one item, totals over items with the share of the mass that they cover.

What the table does not know is absent, never 0: a total says for how much of the edible mass its figure is known, and
a portion whose mass is not known makes every total an incomplete one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.doubt import Estimate, Term, combine
from app.nutrition.mass import Mass
from app.units import content_of_mass


@dataclass(frozen=True, slots=True)
class Portion:
    """One item in a total. pair: names its pair of photographs, whose doubt is shared. sign: -1 for what was left.

    per_100_g: component number -> content of 100 g edible portion of the food. mass: None where it is not known; such a
    portion is left out of the sum, and the total says so.
    """

    food_key: str
    per_100_g: Mapping[str, float]
    mass: Mass | None
    pair: str
    sign: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class NutrientTotal:
    """A total in its component's unit, and the share (0 to 1) of the edible mass for which the content is known.

    coverage: None where a portion's mass is not known: then the total is incomplete, nobody knows by how much.
    """

    amount: Estimate
    coverage: float | None


@dataclass(frozen=True, slots=True)
class MassTotal:
    """Edible grams, and how many portions are left out because their mass is not known: above 0, it is incomplete.

    edible_g: None where there are portions and the mass of none is known.
    """

    edible_g: Estimate | None
    unmeasured: int


def nutrient_amounts(per_100_g: Mapping[str, float], mass: Mass) -> Mapping[str, Estimate]:
    """Component number -> amount in the item's edible mass, with its interval, in the component's unit."""
    return MappingProxyType(
        {number: mass.edible_g.scaled(content_of_mass(content, 1.0)) for number, content in per_100_g.items()}
    )


def total_nutrients(portions: Sequence[Portion]) -> Mapping[str, NutrientTotal]:
    """Component number -> total over the portions, for each component that at least one of them knows.

    In the order of components.csv; those that it does not list come last.
    """
    totals = {}
    measured = _measured(portions)
    whole_g = sum(mass.edible_g.value for _, mass in measured)
    is_whole = len(measured) == len(portions)
    numbers = dict.fromkeys([*COMPONENT_BY_NUMBER, *(n for portion, _ in measured for n in portion.per_100_g)])
    for number in numbers:
        known = [(portion, mass) for portion, mass in measured if number in portion.per_100_g]
        if known:
            covered_g = sum(mass.edible_g.value for _, mass in known)
            terms = [
                _term(portion, mass, content_of_mass(portion.per_100_g[number], mass.edible_g.value))
                for portion, mass in known
            ]
            totals[number] = NutrientTotal(combine(terms), covered_g / whole_g if is_whole else None)
    return MappingProxyType(totals)


def total_mass(portions: Sequence[Portion]) -> MassTotal:
    """Edible grams of all portions together, with the interval."""
    measured = _measured(portions)
    if portions and not measured:
        return MassTotal(None, len(portions))
    total_g = combine([_term(portion, mass, mass.edible_g.value) for portion, mass in measured])
    return MassTotal(total_g, len(portions) - len(measured))


def _measured(portions: Sequence[Portion]) -> list[tuple[Portion, Mass]]:
    return [(portion, portion.mass) for portion in portions if portion.mass is not None]


def _term(portion: Portion, mass: Mass, value: float) -> Term:
    return Term(value, mass.doubt, portion.pair, portion.food_key, portion.sign)
