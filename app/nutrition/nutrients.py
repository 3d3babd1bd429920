"""Edible grams to nutrients: amounts of one item, totals over items with the share of the mass that they cover.

What the table does not know is absent, never 0: a total says for how much of the edible mass its figure is known, and
a portion whose mass is not known makes every total an incomplete one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from app.core.units import content_of_mass
from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.doubt import Doubt, Estimate, Term, combine
from app.nutrition.mass import Mass

NOTHING = Estimate(0.0, 0.0, 0.0)  # grams of what was not eaten at all


@dataclass(frozen=True, slots=True)
class Portion:
    """One item in a total. pair: names its pair of photographs, whose doubt is shared. sign: -1 for what was left.

    share: what part of it the person eats, of a dish that is shared.

    per_100_g: component number -> content of 100 g edible portion of the food. mass: None where it is not known; such a
    portion is left out of the sum, and the total says so.
    """

    food_key: str
    per_100_g: Mapping[str, float]
    mass: Mass | None
    pair: str
    sign: Literal[1, -1] = 1
    share: float = 1.0

    @property
    def edible_g(self) -> float | None:
        """The person's edible grams of it, without a sign."""
        return self.mass.edible_g.value * self.share if self.mass is not None else None


@dataclass(frozen=True, slots=True)
class NutrientTotal:
    """A total in its component's unit, and the share (0 to 1) of the eaten grams for which the content is known.

    A food of which more was left than served, within the error, weighs nothing in it. coverage: None where a portion's
    mass is not known: then the total is incomplete, nobody knows by how much.
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


def nutrients_in(per_100_g: Mapping[str, float], edible_g: Estimate) -> Mapping[str, Estimate]:
    """Component number -> amount in these edible grams, with its interval, in the component's unit."""
    return MappingProxyType(
        {number: edible_g.scaled(content_of_mass(content, 1.0)) for number, content in per_100_g.items()}
    )


def amount_interval(amount: Estimate, edible_g: Estimate) -> tuple[float, float] | None:
    """The 90 % interval of an amount of a component in these grams; None where it would be a false one.

    It carries the doubt about the grams alone. Of a food that has none of the component by its table that leaves the
    interval [0, 0], as if that 0 were beyond doubt; only of no food at all is it.
    """
    is_false = amount == NOTHING and edible_g != NOTHING
    return None if is_false else (amount.low, amount.high)


def interval_in_proportion(amount: float, edible_g: Estimate) -> tuple[float, float] | None:
    """The same where the content is not at hand: it follows from the amount, unless that is 0."""
    if edible_g == NOTHING:
        return 0.0, 0.0
    if amount == 0.0 or edible_g.value == 0.0:
        return None
    per_gram = amount / edible_g.value
    return per_gram * edible_g.low, per_gram * edible_g.high


def total_nutrients(portions: Sequence[Portion]) -> Mapping[str, NutrientTotal]:
    """Component number -> total over the portions, for each component that at least one of them knows.

    In the order of components.csv; those that it does not list come last.
    """
    totals = {}
    measured = _measured(portions)
    eaten_g = _eaten_g(measured)
    whole_g = math.fsum(eaten_g.values())
    is_whole = len(measured) == len(portions)
    numbers = dict.fromkeys([*COMPONENT_BY_NUMBER, *(n for portion, _, _ in measured for n in portion.per_100_g)])
    for number in numbers:
        known = [each for each in measured if number in each[0].per_100_g]
        if known:
            covered_g = math.fsum(eaten_g[key] for key in {portion.food_key for portion, _, _ in known})
            terms = [
                _term(portion, doubt, content_of_mass(portion.per_100_g[number], edible_g))
                for portion, doubt, edible_g in known
            ]
            coverage = covered_g / whole_g if whole_g else float(len(known) == len(measured))
            totals[number] = NutrientTotal(combine(terms), coverage if is_whole else None)
    return MappingProxyType(totals)


def total_mass(portions: Sequence[Portion]) -> MassTotal:
    """Edible grams of all portions together, with the interval."""
    measured = _measured(portions)
    if portions and not measured:
        return MassTotal(None, len(portions))
    total_g = combine([_term(portion, doubt, edible_g) for portion, doubt, edible_g in measured])
    return MassTotal(total_g, len(portions) - len(measured))


def _measured(portions: Sequence[Portion]) -> list[tuple[Portion, Doubt, float]]:
    """(portion, its mass's doubt, the person's edible grams) of those whose mass is known."""
    return [
        (portion, portion.mass.doubt, portion.edible_g)
        for portion in portions
        if portion.mass is not None and portion.edible_g is not None
    ]


def _eaten_g(measured: Sequence[tuple[Portion, Doubt, float]]) -> dict[str, float]:
    """Food -> grams of it that were eaten, served less left, not below 0."""
    eaten_g: dict[str, float] = {}
    for portion, _, edible_g in measured:
        eaten_g[portion.food_key] = eaten_g.get(portion.food_key, 0.0) + portion.sign * edible_g
    return {food_key: max(grams, 0.0) for food_key, grams in eaten_g.items()}


def _term(portion: Portion, doubt: Doubt, value: float) -> Term:
    return Term(value, doubt, portion.pair, portion.food_key, portion.sign)
