"""What a participant's day comes to: its meals, its records that hold, its diary entry.

The database counts and sums by day, CountedDay has the rules. Files have both from
exports/views/views.sql: sums are of whole billionths, so that they are the same in whatever order
and by whatever database they are added.
"""

import statistics
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import InstrumentedAttribute, Session
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement

from app.db.statements import AnyColumn, AnyQuery, stored_text
from app.meals.stored.event_models import DayEvent, DayStatus, DiaryDay
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.models import Participant

SEEN = ("pipeline", "added", "split", "merged")  # origins of items that are in a meal's photographs
FULL = 1.0 - 1e-9  # full coverage, up to rounding
PLACES = {name: place for place, name in enumerate(HEADLINE_COLUMNS)}
DayKey = tuple[date, uuid.UUID]  # local day, participant
DayColumn = sa.ColumnElement[date] | InstrumentedAttribute[date]
DayTable = type[Meal | DiaryDay | EffectiveRecord | DayEvent]
Grams = sa.ColumnElement[float | None] | InstrumentedAttribute[float | None]


class billionths(FunctionElement[int]):  # noqa: N801  # named as the macro of views/macros.sql
    """A number in whole billionths."""

    type = sa.BigInteger()
    inherit_cache = True


@compiles(billionths, "postgresql")
def _billionths_postgresql(element: billionths, compiler: SQLCompiler, **options: object) -> str:
    number = compiler.process(element.clauses, **options)
    return f"CAST(TRUNC({number} * 1e9 + 0.5 * SIGN({number})) AS BIGINT)"


@compiles(billionths, "sqlite")
def _billionths_sqlite(element: billionths, compiler: SQLCompiler, **options: object) -> str:
    number = compiler.process(element.clauses, **options)
    half = f"CASE WHEN {number} < 0 THEN -0.5 ELSE 0.5 END"  # SIGN is not in every build of SQLite
    return f"CAST({number} * 1e9 + {half} AS INTEGER)"  # which truncates


class microseconds_between(FunctionElement[int]):  # noqa: N801  # named as the SQL function that it stands for
    """Microseconds from the first instant to the second."""

    type = sa.BigInteger()
    inherit_cache = True


@compiles(microseconds_between, "postgresql")
def _microseconds_postgresql(
    element: microseconds_between, compiler: SQLCompiler, **options: object
) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"CAST(EXTRACT(EPOCH FROM {second} - {first}) * 1000000 AS BIGINT)"


@compiles(microseconds_between, "sqlite")
def _microseconds_sqlite(
    element: microseconds_between, compiler: SQLCompiler, **options: object
) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    # Stored with six decimals, of which strftime would round to three, and so to the next second.
    seconds = f"strftime('%s', substr({second}, 1, 19)) - strftime('%s', substr({first}, 1, 19))"
    return f"(({seconds}) * 1000000 + substr({second}, 21) - substr({first}, 21))"


class DaysOf(NamedTuple):
    """Local days of participants, both ends included; None: no limit.

    study_id: the study whose participants all are chosen, if any
    """

    participants: Collection[uuid.UUID] | sa.Select[uuid.UUID]
    first_day: date | None = None
    last_day: date | None = None
    study_id: uuid.UUID | None = None

    def rows(self, table: DayTable) -> list[sa.ColumnElement[bool]]:
        """The conditions of a table's rows."""
        days = within(table.local_date, self.first_day, self.last_day)
        if self.study_id is not None and table in (Meal, DiaryDay):
            # by day, as the rows lie: quicker than by participant
            return [table.study_id == self.study_id, *days]
        return [table.participant_id.in_(self.participants), *days]


class Amount(NamedTuple):
    """A day's sum of a component over the items for which it is known, and their share.

    value: None if it is known for no item
    coverage: their share of the eaten grams, 0 to 1; None if the grams of an item or of a whole
        meal are unknown
    """

    value: float | None
    coverage: float | None


NO_ENTRY: tuple[DayStatus, bool] = ("open", False)
NO_MEALS = (0, 0)
NO_ITEMS = (0, 0, 0, None, (None,) * (2 * len(HEADLINE_COLUMNS)))
NOTHING = (0.0,) * len(HEADLINE_COLUMNS)


@dataclass(frozen=True, slots=True)
class CountedDay:
    """A participant's day that has a meal or a diary entry.

    status: closed if all that was eaten is recorded; open without a diary entry
    said_nothing: the entry says that nothing was eaten; it counts while the day has no meal
    unmeasured_meals: without a known food and not confirmed to be without one
    items: the number of records that hold
    unmeasured_items: those whose eaten grams are unknown
    provisional_items: those that an after-meal pair may still change
    eaten_g: sum over the items for which it is known; None if there are none
    amounts: value and coverage of each of HEADLINE_COLUMNS, in turn
    """

    participant_id: uuid.UUID
    local_date: date
    status: DayStatus
    said_nothing: bool
    meals: int
    unmeasured_meals: int
    items: int
    unmeasured_items: int
    provisional_items: int
    eaten_g: float | None
    amounts: Sequence[float | None]

    @property
    def is_closed(self) -> bool:
        """Whether all that was eaten is recorded."""
        return self.status == "closed"

    @property
    def ate_nothing(self) -> bool:
        """Whether the day was closed with "nothing eaten" and has no meal."""
        return self.is_closed and self.said_nothing and self.meals == 0

    @property
    def is_nothing(self) -> bool:
        """Whether the day is closed and nothing was eaten.

        By the entry, or since each meal is confirmed to have no food.
        """
        if not self.is_closed:
            return False
        is_empty = self.meals > 0 and self.items == 0 and self.unmeasured_meals == 0
        return self.ate_nothing or is_empty

    @property
    def is_complete(self) -> bool:
        """Whether the day is closed and all eaten grams are known and final."""
        if not self.is_closed:
            return False
        is_measured = self.items > 0 and self.unmeasured_items == 0 and self.unmeasured_meals == 0
        return (is_measured and self.provisional_items == 0) or self.is_nothing

    def amount(self, column: str) -> Amount:
        """Return the amount of one of HEADLINE_COLUMNS; 0 if nothing was eaten."""
        if self.is_nothing:
            return Amount(0.0, 1.0)
        place = 2 * PLACES[column]
        value, coverage = self.amounts[place : place + 2]
        return Amount(value, coverage if self.unmeasured_meals == 0 else None)

    def whole_amount(self, column: str, least_coverage: float = FULL) -> float | None:
        """The amount, if the day is complete and at least so much of it is known."""
        return whole_amount(self, self.amount(column), least_coverage)

    def whole_amounts(self) -> Sequence[float | None]:
        """`whole_amount` of each of HEADLINE_COLUMNS, of a day that is complete."""
        if self.is_nothing:
            return NOTHING
        values, coverages = self.amounts[::2], self.amounts[1::2]
        return [
            value if coverage is not None and coverage >= FULL else None
            for value, coverage in zip(values, coverages, strict=True)
        ]


def whole_amount(day: CountedDay, amount: Amount, least_coverage: float) -> float | None:
    """A complete day's amount, 0 if nothing was eaten; None if too little of it is known."""
    if day.is_nothing:
        return 0.0
    is_known = amount.coverage is not None and amount.coverage >= least_coverage
    return amount.value if is_known and day.is_complete else None


def delay_seconds(delays: str) -> list[float]:
    """The delays of `delays_text`, in seconds."""
    return [int(delay) / 1e6 for delay in delays.split()]


def median_or_none(seconds: Sequence[float]) -> float | None:
    """The median; None if there are none."""
    return statistics.median(seconds) if seconds else None


def days_of_study(study_id: uuid.UUID, first_day: date | None, last_day: date | None) -> DaysOf:
    """Return the days of all participants of a study."""
    participants = sa.select(Participant.id).where(Participant.study_id == study_id)
    return DaysOf(participants, first_day, last_day, study_id)


def count_days(session: Session, days: DaysOf) -> list[CountedDay]:
    """Return the days with a meal or a diary entry, by (local day, participant)."""
    connection = session.connection()  # whose rows take less time to make than the session's
    entries = {row[:2]: row[2:] for row in connection.execute(_entries(days))}
    meals = {row[:2]: row[2:] for row in connection.execute(_meals(days))}
    items = {row[:2]: (*row[2:6], row[6:]) for row in connection.execute(_items(days))}
    keys = sorted(meals | entries)
    date_of = {day: date.fromisoformat(day) for day in {key[0] for key in keys}}
    id_of = {participant: uuid.UUID(participant) for participant in {key[1] for key in keys}}
    counted = []
    for key in keys:
        local_date, participant = key
        entry, of_meals = entries.get(key, NO_ENTRY), meals.get(key, NO_MEALS)
        of_items = items.get(key, NO_ITEMS)
        counted.append(
            CountedDay(id_of[participant], date_of[local_date], *entry, *of_meals, *of_items)
        )
    return counted


def unseen_leftovers(session: Session, days: DaysOf) -> Mapping[DayKey, int]:
    """Count the items that are counted as eaten up because no photograph shows their leftovers.

    Declared meals have none, since no photograph shows what is left of them.
    """
    record = EffectiveRecord
    is_unseen = sa.and_(
        record.origin.in_(SEEN), record.consumed_g.is_not(None), record.left_g.is_(None)
    )
    query = sa.select(record.local_date, record.participant_id, sa.func.count()).join(
        Meal, Meal.id == record.meal_id
    )
    query = query.where(Meal.origin == "photographed", record.status != "rejected", is_unseen)
    return {(row[0], row[1]): row[2] for row in session.execute(group_by_day(query, days, record))}


def has_place() -> sa.ColumnElement[bool]:
    """Whether a meal's place is stored (it has a latitude)."""
    latitude: sa.ColumnElement[float | None] = Meal.details["location", "latitude"].as_float()
    return latitude.is_not(None)


def within(
    local_date: DayColumn, first_day: date | None, last_day: date | None
) -> list[sa.ColumnElement[bool]]:
    """Return the conditions of a range of local days, both ends included; None: no limit."""
    conditions = []
    if first_day is not None:
        conditions.append(local_date >= first_day)
    if last_day is not None:
        conditions.append(local_date <= last_day)
    return conditions


def count_where(
    condition: sa.ColumnElement[bool] | InstrumentedAttribute[bool],
) -> sa.ColumnElement[int]:
    """Count the rows that meet a condition."""
    return sa.func.count(sa.case((condition, 1)))


def delays_text() -> sa.ColumnElement[str]:
    """Meals' microseconds from eating to arrival, as one text: quicker than a row a meal."""
    delay = microseconds_between(Meal.captured_at, Meal.received_at)
    return sa.func.aggregate_strings(sa.cast(delay, sa.Text), " ")


def _key(table: DayTable) -> tuple[stored_text, stored_text]:
    """The local day and participant, as texts: a date or id for each row takes longer."""
    return stored_text(table.local_date), stored_text(table.participant_id)


def _entries(days: DaysOf) -> AnyQuery:
    entry = DiaryDay
    return sa.select(*_key(entry), entry.status, entry.ate_nothing).where(*days.rows(entry))


def _meals(days: DaysOf) -> AnyQuery:
    columns = (
        *_key(Meal),
        sa.func.count(),
        count_where(_is_unmeasured_meal()),
    )
    return group_by_day(sa.select(*columns), days, Meal)


def _is_unmeasured_meal() -> sa.ColumnElement[bool]:
    """Whether a meal has no known food and is not confirmed to be without food."""
    has_food = sa.exists().where(
        EffectiveRecord.meal_id == Meal.id, EffectiveRecord.status != "rejected"
    )
    return sa.and_(Meal.status != "confirmed", ~has_food)


def _items(days: DaysOf) -> AnyQuery:
    record = EffectiveRecord
    amounts: list[AnyColumn] = []
    for name in HEADLINE_COLUMNS:
        amounts += sum_and_coverage(getattr(record, name))
    query = sa.select(
        *_key(record),
        sa.func.count(),
        sa.func.count() - sa.func.count(record.consumed_g),
        count_where(record.provisional),
        _sum_of(record.consumed_g),
        *amounts,
    )
    return group_by_day(query, days, record).where(record.status != "rejected")


def group_by_day(query: sa.Select[*tuple[Any, ...]], days: DaysOf, table: DayTable) -> AnyQuery:
    """Choose these days' rows of a table, and group them by day."""
    return query.where(*days.rows(table)).group_by(table.participant_id, table.local_date)


def _sum_of(amount: Grams) -> AnyColumn:
    return _from_billionths(sa.func.sum(billionths(amount)))


def _from_billionths(number: AnyColumn) -> AnyColumn:
    return sa.cast(number, sa.Double) / sa.literal_column("1e9")


def sum_and_coverage(amount: Grams) -> tuple[AnyColumn, AnyColumn]:
    """A sum, and its coverage: the share of the eaten grams for which the amount is known.

    The coverage is NULL if any item's grams are unknown. Negative grams (more left than served,
    within the error) have weight 0. If the total weight is 0, the coverage is 1 if the amount is
    known for all records, else 0.
    """
    consumed_g = EffectiveRecord.consumed_g
    # literals, since the same sums are then taken once
    zero: sa.ColumnElement[int] = sa.literal_column("0")
    weight = sa.case((consumed_g > zero, billionths(consumed_g)), else_=zero)
    whole = sa.func.sum(weight)
    unknown = sa.func.sum(weight).filter(amount.is_(None))  # NULL if there is none
    share = _from_billionths(whole - unknown) / _from_billionths(whole)
    coverage = sa.case(
        (sa.func.count() > sa.func.count(consumed_g), sa.null()),
        (unknown.is_(None), sa.literal_column("1.0")),
        (whole > zero, share),
        else_=sa.literal_column("0.0"),
    )
    return _sum_of(amount), coverage
