"""What a participant-day comes to, counted from meals, records and words: the one definition of it.

The sums are the database's, over records that hold (not rejected) of meals that are there (not deleted). What is not
known is NULL, never 0. DaySum keeps what comes out here (diary/day_sum_queries.py); whoever needs a day that has
changed since counts it by this.
"""

from datetime import timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement

from app.db.statements import AnyQuery
from app.diary.models import DaySum, DiaryDay
from app.meals.models import MEAL_STATUSES, Meal
from app.meals.record_models import HEADLINE_COLUMNS, EffectiveRecord
from app.people.models import Participant

SEEN = ("pipeline", "added", "split", "merged")  # origins of items that are in a meal's photographs
FULL = 1.0 - 1e-9  # a coverage of everything, but for rounding
LATE = timedelta(hours=24)  # from eating to arrival: more than this is a late one
COLUMNS = tuple(column.name for column in DaySum.__table__.columns)  # of a day, in this order
STATUS_COLUMNS = tuple(f"{status}_meals" for status in MEAL_STATUSES)


class seconds_between(FunctionElement[float]):  # noqa: N801  # named as the SQL function that it stands for
    """Seconds from the first instant to the second."""

    type = sa.Float()
    inherit_cache = True


@compiles(seconds_between, "postgresql")
def _seconds_postgresql(element: Any, compiler: Any, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"CAST(EXTRACT(EPOCH FROM ({second} - {first})) AS DOUBLE PRECISION)"


@compiles(seconds_between, "sqlite")
def _seconds_sqlite(element: Any, compiler: Any, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"ROUND((julianday({second}) - julianday({first})) * 86400.0, 3)"  # it counts milliseconds


def counted_days(page: sa.CTE) -> AnyQuery:
    """Of the days of a page (participant_id, local_date) those with a meal or a word, as DaySum has them: COLUMNS."""
    meals, delays, eaten = _meals_of(page), _delays_of(page), _records_of(page)
    found: dict[str, Any] = {
        "participant_id": page.c.participant_id,
        "local_date": page.c.local_date,
        "study_id": Participant.study_id,
        "status": sa.func.coalesce(DiaryDay.status, "open"),
        "said_nothing": sa.func.coalesce(DiaryDay.ate_nothing, sa.false()),
        "median_upload_delay_seconds": delays.c.median_seconds,
        "consumed_g": eaten.c.consumed_g,
    }
    for source, names in ((meals, MEAL_COUNTS), (eaten, ITEM_COUNTS)):
        found |= {name: sa.func.coalesce(source.c[name], 0) for name in names}
    for name in HEADLINE_COLUMNS:
        coverage = f"{name}_coverage"
        found[name] = eaten.c[name]
        found[coverage] = sa.case((sa.func.coalesce(meals.c.unmeasured_meals, 0) == 0, eaten.c[coverage]))
    return (
        sa.select(*(found[name].label(name) for name in COLUMNS))
        .select_from(page)
        .join(Participant, Participant.id == page.c.participant_id)
        .outerjoin(DiaryDay, _same_day(DiaryDay, page))
        .outerjoin(meals, _same_day(meals.c, page))
        .outerjoin(delays, _same_day(delays.c, page))
        .outerjoin(eaten, _same_day(eaten.c, page))
        .where(sa.or_(DiaryDay.participant_id.is_not(None), meals.c.meals > 0))
    )


def coverage_of(amount: Any, consumed_g: Any) -> sa.ColumnElement[Any]:
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


MEAL_COUNTS = (
    "meals",
    *STATUS_COLUMNS,
    "meals_after_closing",
    "unmeasured_meals",
    "late_meals",
    "located_meals",
)
ITEM_COUNTS = ("items", "unmeasured_items", "provisional_items", "unseen_leftovers_items")


# The page stands first in each of these, joined by LEFT JOIN: SQLite, which does not know how few its rows are, would
# read all meals and records otherwise.
def _meals_of(page: sa.CTE) -> sa.Subquery:
    came_after = sa.and_(DiaryDay.status == "closed", Meal.received_at > DiaryDay.changed_at)
    is_late = seconds_between(Meal.captured_at, Meal.received_at) > LATE.total_seconds()
    return (
        sa.select(
            page.c.participant_id,
            page.c.local_date,
            sa.func.count(Meal.id).label("meals"),
            *(_how_many(Meal.status == status).label(f"{status}_meals") for status in MEAL_STATUSES),
            _how_many(came_after).label("meals_after_closing"),
            _how_many(is_unmeasured_meal()).label("unmeasured_meals"),
            _how_many(is_late).label("late_meals"),
            _how_many(has_place()).label("located_meals"),
        )
        .select_from(page)
        .outerjoin(Meal, _same_day(Meal, page))
        .outerjoin(DiaryDay, _same_day(DiaryDay, page))
        .group_by(page.c.participant_id, page.c.local_date)
        .subquery()
    )


def _delays_of(page: sa.CTE) -> sa.Subquery:
    """The median delay from eating to arrival: SQLite knows no median, so the one or two in the middle are averaged."""
    delay = seconds_between(Meal.captured_at, Meal.received_at)
    of_day = (page.c.participant_id, page.c.local_date)
    ranked = (
        sa.select(
            page.c.participant_id,
            page.c.local_date,
            delay.label("seconds"),
            sa.func.row_number().over(partition_by=of_day, order_by=(delay, Meal.id)).label("place"),
            sa.func.count().over(partition_by=of_day).label("places"),
        )
        .select_from(page)
        .outerjoin(Meal, _same_day(Meal, page))
        .subquery()
    )
    twice = 2 * ranked.c.place
    return (
        sa.select(ranked.c.participant_id, ranked.c.local_date, sa.func.avg(ranked.c.seconds).label("median_seconds"))
        .where(twice.between(ranked.c.places, ranked.c.places + 2))
        .group_by(ranked.c.participant_id, ranked.c.local_date)
        .subquery()
    )


def _records_of(page: sa.CTE) -> sa.Subquery:
    record = EffectiveRecord
    columns: list[Any] = []
    for name in HEADLINE_COLUMNS:
        amount = getattr(record, name)
        columns += [
            sa.func.sum(amount).label(name),
            coverage_of(amount, record.consumed_g).label(f"{name}_coverage"),
        ]
    return (
        sa.select(
            page.c.participant_id,
            page.c.local_date,
            sa.func.count(record.item_id).label("items"),
            sa.func.count(sa.case((record.consumed_g.is_(None), record.item_id))).label("unmeasured_items"),
            _how_many(record.provisional).label("provisional_items"),
            _how_many(is_leftover_unseen()).label("unseen_leftovers_items"),
            sa.func.sum(record.consumed_g).label("consumed_g"),
            *columns,
        )
        .select_from(page)
        .outerjoin(record, sa.and_(_same_day(record, page), record.status != "rejected"))
        .outerjoin(Meal, Meal.id == record.meal_id)
        .group_by(page.c.participant_id, page.c.local_date)
        .subquery()
    )


def _how_many(condition: Any) -> sa.ColumnElement[int]:
    return sa.func.sum(sa.case((condition, 1), else_=0))


def _same_day(table: Any, page: sa.CTE) -> sa.ColumnElement[bool]:
    return sa.and_(table.participant_id == page.c.participant_id, table.local_date == page.c.local_date)
