"""Edible grams to nutrients: amounts of one item, totals over items with the share of the mass that they cover.

An unknown content is absent, never 0: a total states for which share of the edible mass the content
is known, and a portion of unknown mass makes every total incomplete.
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

NOTHING = Estimate(0.0, 0.0, 0.0)  # grams if nothing was eaten


@dataclass(frozen=True, slots=True)
class Portion:
    """One item in a total.

    pair: its pair of photographs, whose doubt is shared. sign: -1 for leftovers.

    share: the person's share of a shared dish. per_100_g: component number -> content of 100 g
    edible portion. mass: None if not known; the portion is then left out of the sum, and the total
    is marked incomplete.
    """

    food_key: str
    per_100_g: Mapping[str, float]
    mass: Mass | None
    pair: str
    sign: Literal[1, -1] = 1
    share: float = 1.0

    @property
    def edible_g(self) -> float | None:
        """Return the person's edible grams, unsigned."""
        return self.mass.edible_g.value * self.share if self.mass is not None else None


@dataclass(frozen=True, slots=True)
class NutrientTotal:
    """A total in its component's unit, and the share (0 to 1) of the eaten grams for which the content is known.

    A food with more left than served, within the error, has no weight in it. coverage: None if a
    portion's mass is not known: the total is then incomplete by an unknown amount.
    """

    amount: Estimate
    coverage: float | None


@dataclass(frozen=True, slots=True)
class MassTotal:
    """Edible grams, and the number of portions left out because their mass is not known; above 0, it is incomplete.

    edible_g: None if there are portions and none has a known mass.
    """

    edible_g: Estimate | None
    unmeasured: int


def nutrients_in(per_100_g: Mapping[str, float], edible_g: Estimate) -> Mapping[str, Estimate]:
    """Return component number -> amount in these edible grams with its interval, in the component's unit."""
    return MappingProxyType(
        {
            number: edible_g.scaled(content_of_mass(content, 1.0))
            for number, content in per_100_g.items()
        }
    )


def amount_interval(amount: Estimate, edible_g: Estimate) -> tuple[float, float] | None:
    """Return the 90 % interval of a component's amount in these grams; None if it would be misleading.

    The interval covers only the doubt of the grams. For a food with a content of 0 it would be [0,
    0], as if that 0 were certain; it is certain only if nothing was eaten.
    """
    is_misleading = amount == NOTHING and edible_g != NOTHING
    return None if is_misleading else (amount.low, amount.high)


def interval_in_proportion(amount: float, edible_g: Estimate) -> tuple[float, float] | None:
    """Return the same interval without the content at hand: derived from the amount, None if that is 0."""
    if edible_g == NOTHING:
        return 0.0, 0.0
    if amount == 0.0 or edible_g.value == 0.0:
        return None
    per_gram = amount / edible_g.value
    return per_gram * edible_g.low, per_gram * edible_g.high


def total_nutrients(portions: Sequence[Portion]) -> Mapping[str, NutrientTotal]:
    """Return component number -> total over the portions, for each component known for at least one of them.

    In the order of components.csv; components that it does not list come last.
    """
    totals = {}
    measured = _measured(portions)
    eaten_g = _eaten_g(measured)
    total_g = math.fsum(eaten_g.values())
    is_complete = len(measured) == len(portions)
    numbers = dict.fromkeys(
        [*COMPONENT_BY_NUMBER, *(n for portion, _, _ in measured for n in portion.per_100_g)]
    )
    for number in numbers:
        covered = [entry for entry in measured if number in entry[0].per_100_g]
        if covered:
            covered_g = math.fsum(
                eaten_g[key] for key in {portion.food_key for portion, _, _ in covered}
            )
            terms = [
                _term(portion, doubt, content_of_mass(portion.per_100_g[number], edible_g))
                for portion, doubt, edible_g in covered
            ]
            coverage = covered_g / total_g if total_g else float(len(covered) == len(measured))
            totals[number] = NutrientTotal(combine(terms), coverage if is_complete else None)
    return MappingProxyType(totals)


def total_mass(portions: Sequence[Portion]) -> MassTotal:
    """Return the edible grams of all portions together, with the interval."""
    measured = _measured(portions)
    if portions and not measured:
        return MassTotal(None, len(portions))
    total_g = combine([_term(portion, doubt, edible_g) for portion, doubt, edible_g in measured])
    return MassTotal(total_g, len(portions) - len(measured))


def _measured(portions: Sequence[Portion]) -> list[tuple[Portion, Doubt, float]]:
    """Return (portion, doubt of its mass, the person's edible grams) for portions of known mass."""
    return [
        (portion, portion.mass.doubt, portion.edible_g)
        for portion in portions
        if portion.mass is not None and portion.edible_g is not None
    ]


def _eaten_g(measured: Sequence[tuple[Portion, Doubt, float]]) -> dict[str, float]:
    """Return food key -> grams eaten: served minus left, at least 0."""
    eaten_g: dict[str, float] = {}
    for portion, _, edible_g in measured:
        eaten_g[portion.food_key] = eaten_g.get(portion.food_key, 0.0) + portion.sign * edible_g
    return {food_key: max(grams, 0.0) for food_key, grams in eaten_g.items()}


def _term(portion: Portion, doubt: Doubt, value: float) -> Term:
    return Term(value, doubt, portion.pair, portion.food_key, portion.sign)
