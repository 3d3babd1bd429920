"""What a participant-day comes to, counted from meals, records and words: the one definition of it.

The sums are the database's, over records that hold (not rejected) of meals that are there (not deleted). What is not
known is NULL, never 0. DaySum keeps what comes out here (diary/day_sum_queries.py); whoever needs a day that has
changed since counts it by this.
"""

from datetime import date, timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.sql.base import ReadOnlyColumnCollection
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement

from app.db.statements import AnyQuery
from app.diary.models import DayMark, DaySum
from app.meals.day_models import DayEvent, DiaryDay
from app.meals.models import MEAL_STATUSES, Meal
from app.meals.record_models import HEADLINE_COLUMNS, EffectiveRecord
from app.people.models import Participant

SEEN = ("pipeline", "added", "split", "merged")  # origins of items that are in a meal's photographs
FULL = 1.0 - 1e-9  # a coverage of everything, but for rounding
LATE = timedelta(hours=24)  # from eating to arrival: more than this is a late one
COLUMNS = tuple(column.name for column in DaySum.__table__.columns)  # of a day, in this order
DayColumn = sa.ColumnElement[date] | InstrumentedAttribute[date]
Amount = sa.ColumnElement[float | None] | InstrumentedAttribute[float | None]
DayKeys = (  # has columns participant_id and local_date
    type[Meal | DiaryDay | EffectiveRecord | DaySum | DayMark | DayEvent]
    | ReadOnlyColumnCollection[str, sa.ColumnElement[Any]]
)


class seconds_between(FunctionElement[float]):  # noqa: N801  # named as the SQL function that it stands for
    """Seconds from the first instant to the second."""

    type = sa.Float()
    inherit_cache = True


@compiles(seconds_between, "postgresql")
def _seconds_postgresql(element: seconds_between, compiler: SQLCompiler, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"CAST(EXTRACT(EPOCH FROM ({second} - {first})) AS DOUBLE PRECISION)"


@compiles(seconds_between, "sqlite")
def _seconds_sqlite(element: seconds_between, compiler: SQLCompiler, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"ROUND((julianday({second}) - julianday({first})) * 86400.0, 3)"  # it counts milliseconds


def counted_days(page: sa.CTE) -> AnyQuery:
    """Of the days of a page (participant_id, local_date) those with a meal or an entry, as DaySum has them: COLUMNS."""
    meals, delays, eaten = _meals_of(page), _delays_of(page), _records_of(page)
    values: dict[str, sa.ColumnElement[Any]] = {
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
    """The share of the eaten grams for which an amount is known; NULL where grams are not known.

    Differences below zero (more left than served, within the error) weigh nothing. Where nothing weighs anything, all
    was left: known of everything, or not.
    """
    weight_g = sa.case((consumed_g > 0.0, consumed_g), else_=0.0)
    known_g = sa.func.sum(sa.case((amount.is_not(None), weight_g), else_=0.0))
    unknown = sa.func.sum(sa.case((consumed_g.is_(None), 1), else_=0))
    of_nothing = sa.case((sa.func.count(amount) == sa.func.count(), 1.0), else_=0.0)
    of_what_was_eaten = known_g / sa.func.nullif(sa.func.sum(weight_g), 0.0)
    return sa.case((unknown == 0, sa.func.coalesce(of_what_was_eaten, of_nothing)))


def is_unmeasured_meal() -> sa.ColumnElement[bool]:
    """Whether no food is known of a meal (it failed, or is not measured yet) and nobody has confirmed that it is so."""
    has_food = sa.exists().where(EffectiveRecord.meal_id == Meal.id, EffectiveRecord.status != "rejected")
    return sa.and_(Meal.id.is_not(None), Meal.status != "confirmed", ~has_food)


def is_leftover_unseen() -> sa.ColumnElement[bool]:
    """Whether a record's eaten grams are all that was served since nobody has looked what was left.

    Of what was declared no camera sees what is left. For a query of records with their Meal.
    """
    return sa.and_(
        Meal.origin == "photographed",
        EffectiveRecord.origin.in_(SEEN),
        EffectiveRecord.consumed_g.is_not(None),
        EffectiveRecord.left_g.is_(None),
    )


def has_place() -> sa.ColumnElement[bool]:
    """Whether a meal's place is kept: it has a latitude."""
    latitude: sa.ColumnElement[float | None] = Meal.details["location"]["latitude"].as_float()
    return latitude.is_not(None)


def within(local_date: DayColumn, first_day: date | None, last_day: date | None) -> list[sa.ColumnElement[bool]]:
    """The conditions of a range of local days, both included."""
    conditions = []
    if first_day is not None:
        conditions.append(local_date >= first_day)
    if last_day is not None:
        conditions.append(local_date <= last_day)
    return conditions


def is_day_of_nothing(day: sa.Subquery) -> sa.ColumnElement[bool]:
    """Whether a day is closed and nothing was eaten; as DayRow.is_nothing."""
    is_empty = sa.and_(day.c.meals > 0, day.c["items"] == 0, day.c.unmeasured_meals == 0)
    return sa.and_(day.c.status == "closed", sa.or_(sa.and_(day.c.said_nothing, day.c.meals == 0), is_empty))


def is_measured_whole(day: sa.Subquery) -> sa.ColumnElement[bool]:
    """Whether a day is closed, and the grams of all that was eaten are known and final; as DayRow.is_complete."""
    is_known = sa.and_(day.c.unmeasured_items == 0, day.c.unmeasured_meals == 0, day.c.provisional_items == 0)
    return sa.and_(day.c.status == "closed", day.c["items"] > 0, is_known)


def same_day(table: DayKeys, page: DayKeys) -> sa.ColumnElement[bool]:
    """Whether both are of one participant's day."""
    return sa.and_(table.participant_id == page.participant_id, table.local_date == page.local_date)


def how_many(condition: sa.ColumnElement[bool] | InstrumentedAttribute[bool]) -> sa.ColumnElement[int]:
    """The number of rows that meet a condition."""
    return sa.func.sum(sa.case((condition, 1), else_=0))


def total(counts: sa.ColumnElement[int]) -> sa.ColumnElement[int]:
    """A sum of counts as an integer: PostgreSQL adds big integers up to a decimal number."""
    return sa.cast(sa.func.sum(counts), sa.BigInteger)


ITEM_COUNTS = ("items", "unmeasured_items", "provisional_items", "unseen_leftovers_items")


# The page stands first in each of these, joined by LEFT JOIN: SQLite, which does not know how few its rows are, would
# read all meals and records otherwise.
def _meals_of(page: sa.CTE) -> sa.Subquery:
    came_after = sa.and_(DiaryDay.status == "closed", Meal.received_at > DiaryDay.changed_at)
    is_late = seconds_between(Meal.captured_at, Meal.received_at) > LATE.total_seconds()
    return (
        sa.select(
            *page.c,
            sa.func.count(Meal.id).label("meals"),
            *(how_many(Meal.status == status).label(f"{status}_meals") for status in MEAL_STATUSES),
            how_many(came_after).label("meals_after_closing"),
            how_many(is_unmeasured_meal()).label("unmeasured_meals"),
            how_many(is_late).label("late_meals"),
            how_many(has_place()).label("located_meals"),
        )
        .select_from(page)
        .outerjoin(Meal, same_day(Meal, page.c))
        .outerjoin(DiaryDay, same_day(DiaryDay, page.c))
        .group_by(*page.c)
        .subquery()
    )


def _delays_of(page: sa.CTE) -> sa.Subquery:
    """The median delay from eating to arrival: SQLite knows no median, so the one or two in the middle are averaged."""
    delay = seconds_between(Meal.captured_at, Meal.received_at)
    ranked = (
        sa.select(
            *page.c,
            delay.label("seconds"),
            sa.func.row_number().over(partition_by=[*page.c], order_by=(delay, Meal.id)).label("place"),
            sa.func.count().over(partition_by=[*page.c]).label("places"),
        )
        .select_from(page)
        .outerjoin(Meal, same_day(Meal, page.c))
        .subquery()
    )
    twice = 2 * ranked.c.place
    of_day = (ranked.c.participant_id, ranked.c.local_date)
    return (
        sa.select(*of_day, sa.func.avg(ranked.c.seconds).label("median_seconds"))
        .where(twice.between(ranked.c.places, ranked.c.places + 2))
        .group_by(*of_day)
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
            how_many(record.provisional).label("provisional_items"),
            how_many(is_leftover_unseen()).label("unseen_leftovers_items"),
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
