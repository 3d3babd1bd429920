"""Amounts of components in what was eaten, for any table: of a record, or summed over records with their coverage.

What the food's immutable version does not know is None, never 0. A sum tells for which share of the eaten grams it is
known, by the rule that days have (diary/queries.py).
"""

import math
import uuid
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.core.units import content_of_mass
from app.exports.export_spec import ExportSpec
from app.exports.tables.record_queries import Lookup
from app.foods.models import Component, Food, FoodNutrient
from app.foods.queries import contents_of
from app.http.tables.columns import Batch, Part, PartOfBatch
from app.http.tables.component_columns import (
    KNOWN,
    OF_COMPONENT,
    ComponentColumn,
    component_column,
    headline_columns,
)
from app.meals.record_models import EffectiveRecord
from app.nutrition.components import COMPONENT_BY_NUMBER, HEADLINE_NUMBERS
from app.people.access.caller import Caller, visible_studies
from app.records.page_queries import studies_of

MOST_FOODS = 2000  # whose contents are kept in memory, some 100 figures each

Amounts = Sequence[float | None]
Sums = Sequence[tuple[float | None, float | None]]  # a component's sum and its coverage

HEADLINE_COMPONENTS = headline_columns(
    HEADLINE_NUMBERS,
    [(COMPONENT_BY_NUMBER[numbers[0]].tagname, COMPONENT_BY_NUMBER[numbers[0]].name) for numbers in HEADLINE_NUMBERS],
)


@dataclass(frozen=True, slots=True)
class Eaten:
    """A record in a sum: the grams that were eaten (None: not known), and each component's amount in them."""

    consumed_g: float | None
    amounts: Amounts


class FoodContents:
    """What foods hold of these components; keeps what it has read."""

    def __init__(self, session: Session, components: Sequence[ComponentColumn]) -> None:
        numbers = [each.numbers for each in components]
        self._per_100_g = Lookup(
            lambda ids: {food_id: _of(known, numbers) for food_id, known in contents_of(session, ids).items()},
            MOST_FOODS,
        )

    def per_100_g(self, food_ids: Sequence[int | None]) -> list[Amounts]:
        """Of each food, in the order of the components."""
        return self._per_100_g(food_ids)

    def amounts(self, food_ids: Sequence[int | None], consumed_g: Sequence[float | None]) -> list[Amounts]:
        """In so many grams of each food, as a record's own columns are computed."""
        return [
            [None if content is None else grams * content_of_mass(content, 1.0) for content in contents]
            if grams is not None
            else (None,) * len(contents)
            for contents, grams in zip(self.per_100_g(food_ids), consumed_g, strict=True)
        ]


def components_for(session: Session, caller: Caller, spec: ExportSpec) -> list[ComponentColumn]:
    """Those of the foods that records of the export's studies have: the same whatever its other filters are."""
    studies = studies_of(session, spec.filters.study_code, visible_studies(caller))
    component_columns = [
        component_column(component.number, component.name, component.unit, component.tagname, component.expression)
        for component in _components_in_use(session, studies)
    ]
    names = [component.column.name for component in component_columns]
    if len(set(names)) < len(names):
        raise AssertionError("two components would share a column")
    return component_columns


def sums(eaten: Sequence[Eaten], count: int, *, is_nothing: bool, is_partial: bool) -> Sums:
    """Of each of `count` components the sum over these records and its coverage.

    is_nothing: it is known that nothing was eaten. is_partial: something was eaten of which there is no record.
    """
    if is_nothing:
        return [(0.0, 1.0)] * count
    if not eaten:
        return [(None, None)] * count
    weights = [max(food.consumed_g or 0.0, 0.0) for food in eaten]
    whole_g = math.fsum(weights)
    is_unknown = is_partial or any(food.consumed_g is None for food in eaten)
    totals: list[tuple[float | None, float | None]] = []
    for place in range(count):
        weighted = [(food.amounts[place], weight) for food, weight in zip(eaten, weights, strict=True)]
        values = [value for value, _ in weighted if value is not None]
        coverage = None
        if not is_unknown:
            of_nothing = float(len(values) == len(weighted))
            known_g = math.fsum(weight for value, weight in weighted if value is not None)
            coverage = known_g / whole_g if whole_g else of_nothing
        totals.append((math.fsum(values) if values else None, coverage))
    return totals


def long_batch(
    own: Iterable[PartOfBatch], components: Sequence[ComponentColumn], pairs: Sequence[Sums], part: Part
) -> Batch:
    """A row a component from a row each. pairs: the values of `part`, the amount and what stands beside it."""
    values = list(chain.from_iterable(pairs))
    return [
        *(each.repeated(len(components)) for each in own),
        PartOfBatch(OF_COMPONENT, [each.of_long_row for each in components], list(range(len(components))) * len(pairs)),
        PartOfBatch(part, values),
        PartOfBatch(KNOWN, [amount is not None for amount, _ in values]),
    ]


def _of(known: dict[str, float], numbers: Sequence[tuple[str, ...]]) -> Amounts:
    return [next((known[number] for number in its if number in known), None) for its in numbers]


def _components_in_use(session: Session, study_ids: Collection[uuid.UUID] | None) -> Sequence[Component]:
    """Return the components that foods of these studies' records have, ordered as in components.csv. None: all studies.

    Each food is looked up once in the index of records, however many records there are.
    """
    record = EffectiveRecord
    first = sa.select(record.food_id).where(record.food_id == Food.id).limit(1)
    if study_ids is not None:
        first = first.where(record.study_id.in_(study_ids))
    used = sa.select(Food.id).where(first.correlate(Food).scalar_subquery().is_not(None))
    component_ids = sa.select(FoodNutrient.component_id).where(FoodNutrient.food_id.in_(used))
    return session.scalars(sa.select(Component).where(Component.id.in_(component_ids)).order_by(Component.id)).all()
