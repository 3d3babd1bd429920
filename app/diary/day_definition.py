"""SQL that defines a participant-day: its counts and sums from meals, records and diary entries.

The database sums the records that count (not rejected) of meals that are not deleted. Unknown values are NULL, never 0.
DaySum stores the results; sums are read by day_sum_queries.py, which uses this module for days that have changed since.
"""

from datetime import date, timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.sql.base import ReadOnlyColumnCollection
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement

from app.db.statements import AnyColumn, AnyQuery
from app.diary.models import DayMark, DaySum
from app.meals.day_models import DayEvent, DiaryDay
from app.meals.models import MEAL_STATUSES, Meal
from app.meals.record_models import HEADLINE_COLUMNS, EffectiveRecord
from app.people.models import Participant

SEEN = ("pipeline", "added", "split", "merged")  # origins of items that are in a meal's photographs
FULL = 1.0 - 1e-9  # full coverage, up to rounding
LATE = timedelta(hours=24)  # from eating to arrival; a meal that takes longer is late
COLUMNS = tuple(column.name for column in DaySum.__table__.columns)
DayColumn = sa.ColumnElement[date] | InstrumentedAttribute[date]
Amount = sa.ColumnElement[float | None] | InstrumentedAttribute[float | None]
DayKeys = (  # has columns participant_id and local_date
    type[Meal | DiaryDay | EffectiveRecord | DaySum | DayMark | DayEvent]
    | ReadOnlyColumnCollection[str, sa.ColumnElement[Any]]  # as SQLAlchemy types the columns of a subquery
)


class seconds_between(FunctionElement[float]):  # noqa: N801  # named as the SQL function that it stands for
    """Seconds from the first instant to the second."""

    type = sa.Float()
    inherit_cache = True


@compiles(seconds_between, "postgresql")
def _seconds_postgresql(element: seconds_between, compiler: SQLCompiler, **options: object) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    seconds = (f"ROUND(EXTRACT(EPOCH FROM {instant}), 3)" for instant in (second, first))  # in milliseconds, as SQLite
    return f"CAST({' - '.join(seconds)} AS DOUBLE PRECISION)"


@compiles(seconds_between, "sqlite")
def _seconds_sqlite(element: seconds_between, compiler: SQLCompiler, **options: object) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"ROUND((julianday({second}) - julianday({first})) * 86400.0, 3)"  # SQLite's times are in milliseconds


def counted_days(page: sa.CTE) -> AnyQuery:
    """Count the days of a page (participant_id, local_date) that have a meal or a diary entry; columns: COLUMNS."""
    meals, delays, eaten = _meals_of(page), _delays_of(page), _records_of(page)
    values: dict[str, AnyColumn] = {
        "study_id": Participant.study_id.expression,
        "status": sa.func.coalesce(DiaryDay.status, "open"),
        "said_nothing": sa.func.coalesce(DiaryDay.ate_nothing, sa.false()),
        "median_upload_delay_seconds": delays.c.median_seconds,
    }
    values |= {column.name: sa.func.coalesce(column, 0) for column in meals.c}
    values |= {column.name: column for column in eaten.c}
    values |= {name: sa.func.coalesce(eaten.c[name], 0) for name in ITEM_COUNTS}
    for name in HEADLINE_COLUMNS:
        coverage = f"{name}_coverage"
        values[coverage] = sa.case((values["unmeasured_meals"] == 0, eaten.c[coverage]))
    values |= {column.name: column for column in page.c}
    return (
        sa.select(*(values[name].label(name) for name in COLUMNS))
        .select_from(page)
        .join(Participant, Participant.id == page.c.participant_id)
        .outerjoin(DiaryDay, same_day(DiaryDay, page.c))
        .outerjoin(meals, same_day(meals.c, page.c))
        .outerjoin(delays, same_day(delays.c, page.c))
        .outerjoin(eaten, same_day(eaten.c, page.c))
        .where(sa.or_(DiaryDay.participant_id.is_not(None), meals.c.meals > 0))
    )


def coverage_of(amount: Amount, consumed_g: Amount) -> sa.ColumnElement[float | None]:
    """Return the share of the eaten grams for which an amount is known; NULL if any item's grams are unknown.

    Negative grams (more left than served, within the error) have weight 0. If the total weight is 0, the coverage is 1
    if the amount is known for all records, else 0.
    """
    weight_g = sa.case((consumed_g > 0.0, consumed_g), else_=0.0)
    known_g = sa.func.sum(sa.case((amount.is_not(None), weight_g), else_=0.0))
    unknown = sa.func.sum(sa.case((consumed_g.is_(None), 1), else_=0))
    share_without_weight = sa.case((sa.func.count(amount) == sa.func.count(), 1.0), else_=0.0)
    share_of_weight = known_g / sa.func.nullif(sa.func.sum(weight_g), 0.0)
    return sa.case((unknown == 0, sa.func.coalesce(share_of_weight, share_without_weight)))


def is_unmeasured_meal() -> sa.ColumnElement[bool]:
    """Whether a meal has no known food (failed or not measured yet) and is not confirmed to be without food."""
    has_food = sa.exists().where(EffectiveRecord.meal_id == Meal.id, EffectiveRecord.status != "rejected")
    return sa.and_(Meal.id.is_not(None), Meal.status != "confirmed", ~has_food)


def is_leftover_unseen() -> sa.ColumnElement[bool]:
    """Whether a record's eaten grams are all that was served because no leftovers were recorded.

    False for declared meals, whose leftovers no photograph shows. Use it in a query of records joined to Meal.
    """
    return sa.and_(
        Meal.origin == "photographed",
        EffectiveRecord.origin.in_(SEEN),
        EffectiveRecord.consumed_g.is_not(None),
        EffectiveRecord.left_g.is_(None),
    )


def has_place() -> sa.ColumnElement[bool]:
    """Whether a meal's place is stored (it has a latitude)."""
    latitude: sa.ColumnElement[float | None] = Meal.details["location"]["latitude"].as_float()
    return latitude.is_not(None)


def within(local_date: DayColumn, first_day: date | None, last_day: date | None) -> list[sa.ColumnElement[bool]]:
    """Return the conditions of a range of local days, both ends included; None: no limit."""
    conditions = []
    if first_day is not None:
        conditions.append(local_date >= first_day)
    if last_day is not None:
        conditions.append(local_date <= last_day)
    return conditions


def is_day_of_nothing(day: sa.Subquery) -> sa.ColumnElement[bool]:
    """Whether a day is closed and nothing was eaten; the same as DayRow.is_nothing."""
    is_empty = sa.and_(day.c.meals > 0, day.c["items"] == 0, day.c.unmeasured_meals == 0)
    return sa.and_(day.c.status == "closed", sa.or_(sa.and_(day.c.said_nothing, day.c.meals == 0), is_empty))


def is_measured_whole(day: sa.Subquery) -> sa.ColumnElement[bool]:
    """Whether a day is closed and has items, all of known and final grams; with nothing eaten: DayRow.is_complete."""
    is_known = sa.and_(day.c.unmeasured_items == 0, day.c.unmeasured_meals == 0, day.c.provisional_items == 0)
    return sa.and_(day.c.status == "closed", day.c["items"] > 0, is_known)


def whole_day_amount(
    day: sa.Subquery, amount: AnyColumn, coverage: AnyColumn, least_coverage: float = FULL
) -> sa.ColumnElement[float | None]:
    """Return a whole day's amount of a component: 0 if nothing was eaten; NULL if the day is not whole.

    A day is whole if it is closed, measured and final, and at least `least_coverage` of the component is known.
    """
    is_known = sa.and_(is_measured_whole(day), coverage >= least_coverage)
    return sa.case((is_day_of_nothing(day), 0.0), (is_known, amount))


def same_day(table: DayKeys, page: DayKeys) -> sa.ColumnElement[bool]:
    """Whether both rows are of the same participant and local day."""
    return sa.and_(table.participant_id == page.participant_id, table.local_date == page.local_date)


def count_where(condition: sa.ColumnElement[bool] | InstrumentedAttribute[bool]) -> sa.ColumnElement[int]:
    """Count the rows that meet a condition."""
    return sa.func.sum(sa.case((condition, 1), else_=0))


def total(counts: sa.ColumnElement[int]) -> sa.ColumnElement[int]:
    """Sum counts as an integer: PostgreSQL's sum of big integers is a decimal number."""
    return sa.cast(sa.func.sum(counts), sa.BigInteger)


ITEM_COUNTS = ("items", "unmeasured_items", "provisional_items", "unseen_leftovers_items")


# The page comes first in each of these, joined by LEFT JOIN: otherwise SQLite, which does not know how few rows it has,
# reads all meals and records.
def _meals_of(page: sa.CTE) -> sa.Subquery:
    arrived_after_closing = sa.and_(DiaryDay.status == "closed", Meal.received_at > DiaryDay.changed_at)
    is_late = seconds_between(Meal.captured_at, Meal.received_at) > LATE.total_seconds()
    return (
        sa.select(
            *page.c,
            sa.func.count(Meal.id).label("meals"),
            *(count_where(Meal.status == status).label(f"{status}_meals") for status in MEAL_STATUSES),
            count_where(arrived_after_closing).label("meals_after_closing"),
            count_where(is_unmeasured_meal()).label("unmeasured_meals"),
            count_where(is_late).label("late_meals"),
            count_where(has_place()).label("located_meals"),
        )
        .select_from(page)
        .outerjoin(Meal, same_day(Meal, page.c))
        .outerjoin(DiaryDay, same_day(DiaryDay, page.c))
        .group_by(*page.c)
        .subquery()
    )


def _delays_of(page: sa.CTE) -> sa.Subquery:
    """Return the median delay from eating to arrival: the mean of the middle one or two, as SQLite has no median."""
    delay = seconds_between(Meal.captured_at, Meal.received_at)
    ranked = (
        sa.select(
            *page.c,
            delay.label("seconds"),
            sa.func.row_number().over(partition_by=[*page.c], order_by=(delay, Meal.id)).label("rank"),
            sa.func.count().over(partition_by=[*page.c]).label("delays"),
        )
        .select_from(page)
        .outerjoin(Meal, same_day(Meal, page.c))
        .subquery()
    )
    keys = (ranked.c.participant_id, ranked.c.local_date)
    return (
        sa.select(*keys, sa.func.avg(ranked.c.seconds).label("median_seconds"))
        .where((2 * ranked.c.rank).between(ranked.c.delays, ranked.c.delays + 2))
        .group_by(*keys)
        .subquery()
    )


def _records_of(page: sa.CTE) -> sa.Subquery:
    record = EffectiveRecord
    amounts = {name: getattr(record, name) for name in HEADLINE_COLUMNS}
    return (
        sa.select(
            *page.c,
            sa.func.count(record.item_id).label("items"),
            sa.func.count(sa.case((record.consumed_g.is_(None), record.item_id))).label("unmeasured_items"),
            count_where(record.provisional).label("provisional_items"),
            count_where(is_leftover_unseen()).label("unseen_leftovers_items"),
            sa.func.sum(record.consumed_g).label("consumed_g"),
            *(sa.func.sum(amount).label(name) for name, amount in amounts.items()),
            *(coverage_of(amount, record.consumed_g).label(f"{name}_coverage") for name, amount in amounts.items()),
        )
        .select_from(page)
        .outerjoin(record, sa.and_(same_day(record, page.c), record.status != "rejected"))
        .outerjoin(Meal, Meal.id == record.meal_id)
        .group_by(*page.c)
        .subquery()
    )
