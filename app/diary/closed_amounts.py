"""SQL of the amounts of a component that participants ate on their closed days, for usual intakes.

Amounts come from the days' sums if the component is one of their columns; otherwise from records and the contents of
their foods, which takes longer in a large study. Both follow one rule, `whole_day_amount`.
"""

import uuid
from collections import defaultdict
from dataclasses import dataclass
from datetime import date
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn
from app.db.stored_ids import stored_id
from app.diary.day_definition import coverage_of, same_day, whole_day_amount, within
from app.diary.day_sum_queries import select_study_days, sums_of_days
from app.foods.models import Component, FoodNutrient
from app.meals.record_models import EffectiveRecord
from app.people.models import Participant
from app.people.profiles import Profile

UNKNOWN = "?"  # an amount, in a text


@dataclass(frozen=True, slots=True)
class ClosedAmounts:
    """A participant's closed days, at least one. amounts: of the days on which it is known, in order."""

    profile: Profile | None
    last_day: date
    days: int
    amounts: list[float]


class StudyWindow(NamedTuple):
    """Local days of a study, both ends included; None: no limit."""

    study_id: uuid.UUID
    first_day: date | None = None
    last_day: date | None = None


def amounts_by_column(
    session: Session, window: StudyWindow, column: str, *, least_coverage: float
) -> list[ClosedAmounts]:
    """Return the amounts of one of HEADLINE_COLUMNS, of all participants with a closed day, by participant id."""
    day = sums_of_days(session, select_study_days(*window))
    amount = whole_day_amount(day, day.c[column], day.c[f"{column}_coverage"], least_coverage)
    return _amounts(session, window, day, day, amount)


def amounts_by_record(
    session: Session, window: StudyWindow, number: str, subtracted: str | None, *, least_coverage: float
) -> list[ClosedAmounts]:
    """Return the amounts of any component of the food table, of all participants with a closed day, by participant id.

    subtracted: number of a component to subtract (fibre from carbohydrate); the difference is unknown where it is.
    """
    day = sums_of_days(session, select_study_days(*window))
    content = _content_by_day(window, number, subtracted)
    amount = whole_day_amount(day, content.c.amount, content.c.coverage, least_coverage)
    return _amounts(session, window, day, day.outerjoin(content, same_day(content.c, day.c)), amount)


def _amounts(
    session: Session,
    window: StudyWindow,
    day: sa.Subquery,
    source: sa.FromClause,
    amount: sa.ColumnElement[float | None],
) -> list[ClosedAmounts]:
    """Read the amounts of closed days.

    Each local day is one text of participants' ids and amounts: one row per day and participant would take several
    times as long.
    """
    pair = stored_id(day.c.participant_id) + " " + sa.func.coalesce(sa.cast(amount, sa.Text), UNKNOWN)
    query = (
        sa.select(day.c.local_date, sa.func.aggregate_strings(pair, " "))
        .select_from(source)
        .where(day.c.status == "closed")
        .group_by(day.c.local_date)
        .order_by(day.c.local_date)
    )
    amounts: dict[str, list[str]] = defaultdict(list)
    last_days: dict[str, date] = {}
    for local_date, text in session.execute(query):
        fields = text.split()
        participants = fields[::2]
        for participant, day_amount in zip(participants, fields[1::2], strict=True):
            amounts[participant].append(day_amount)
        last_days.update(dict.fromkeys(participants, local_date))
    profiles = session.execute(
        sa.select(stored_id(Participant.id), Participant.profile)
        .where(Participant.study_id == window.study_id)
        .order_by(Participant.id)
    )
    return [
        ClosedAmounts(
            profile,
            last_days[participant],
            len(amounts[participant]),
            [float(amount) for amount in amounts[participant] if amount != UNKNOWN],
        )
        for participant, profile in profiles
        if participant in amounts
    ]


def _content_by_day(window: StudyWindow, number: str, subtracted: str | None) -> sa.Subquery:
    """Sum a component over each day's records, with its coverage; days without records have no row."""
    record, content = EffectiveRecord, _contents(number)
    per_100_g: AnyColumn = content.c.per_100_g
    query = sa.select(record.participant_id, record.local_date).outerjoin(content, content.c.food_id == record.food_id)
    if subtracted is not None:
        other = _contents(subtracted)
        per_100_g = per_100_g - other.c.per_100_g
        query = query.outerjoin(other, other.c.food_id == record.food_id)
    return (
        query.add_columns(
            sa.func.sum(record.consumed_g * per_100_g / 100.0).label("amount"),
            coverage_of(per_100_g, record.consumed_g).label("coverage"),
        )
        .where(record.study_id == window.study_id, *within(record.local_date, window.first_day, window.last_day))
        .where(record.status != "rejected")
        .group_by(record.participant_id, record.local_date)
        .subquery("content")
    )


def _contents(number: str) -> sa.Subquery:
    return (
        sa.select(FoodNutrient.food_id, FoodNutrient.per_100_g)
        .join(Component, Component.id == FoodNutrient.component_id)
        .where(Component.number == number)
        .subquery()
    )
