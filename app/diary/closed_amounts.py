"""SQL of what participants ate of a component on their closed days, a row a person, for usual intakes.

Told from the days' sums where the component is a column of theirs; else from the records and what their foods hold,
which takes twenty times as long in a large study. Both by the same rule: the amount of a closed day is known where
nothing was eaten (0), or the grams of all that was are known and final and a least coverage of the component is.
"""

import uuid
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.stored_ids import stored_id
from app.diary.day_definition import coverage_of, is_day_of_nothing, is_measured_whole, within
from app.diary.intake_queries import ClosedDay, closed_days
from app.diary.queries import Amount, of_study, sums_of_days
from app.foods.models import Component, FoodNutrient
from app.meals.record_models import EffectiveRecord
from app.people.models import Participant

UNKNOWN = "?"  # an amount, in a text


@dataclass(frozen=True, slots=True)
class ClosedAmounts:
    """A participant's closed days, one at least. amounts: of those where it is known, in the order of the days."""

    profile: Mapping[str, Any] | None
    last_day: date
    days: int
    amounts: list[float]


def amounts_by_column(
    session: Session,
    study_id: uuid.UUID,
    column: str,
    *,
    least_coverage: float,
    first_day: date | None,
    last_day: date | None,
) -> list[ClosedAmounts]:
    """Of one of HEADLINE_COLUMNS, of all participants who have a closed day, by their ids.

    A day comes as one text, everybody's id and amount: a row a day and person would take several times as long, and
    those of a person lie apart.
    """
    day = sums_of_days(session, of_study(study_id, first_day, last_day))
    is_known = sa.and_(is_measured_whole(day), day.c[f"{column}_coverage"] >= least_coverage)
    amount = sa.cast(sa.case((is_day_of_nothing(day), 0.0), (is_known, day.c[column])), sa.Text)
    word = stored_id(day.c.participant_id) + " " + sa.func.coalesce(amount, UNKNOWN)
    query = (
        sa.select(day.c.local_date, sa.func.aggregate_strings(word, " "))
        .where(day.c.status == "closed")
        .group_by(day.c.local_date)
        .order_by(day.c.local_date)
    )
    told: dict[str, list[str]] = defaultdict(list)
    last: dict[str, date] = {}
    for on, text in session.execute(query):
        words = text.split()
        people = words[::2]
        for person, amount_then in zip(people, words[1::2], strict=True):
            told[person].append(amount_then)
        last.update(dict.fromkeys(people, on))
    profiles = session.execute(
        sa.select(stored_id(Participant.id), Participant.profile)
        .where(Participant.study_id == study_id)
        .order_by(Participant.id)
    )
    return [
        ClosedAmounts(
            profile, last[person], len(told[person]), [float(each) for each in told[person] if each != UNKNOWN]
        )
        for person, profile in profiles
        if person in told
    ]


def amounts_by_record(
    session: Session,
    study_id: uuid.UUID,
    number: str,
    less: str | None,
    *,
    least_coverage: float,
    first_day: date | None,
    last_day: date | None,
) -> list[ClosedAmounts]:
    """Of any component of the food table, of all participants who have a closed day, by their ids.

    less: another that is taken off it (fibre from carbohydrate), unknown where that is unknown.
    """
    amounts = _component_by_day(session, study_id, number, less, first_day, last_day)
    people = sa.select(Participant.id, Participant.profile).where(Participant.study_id == study_id)
    profiles = {row[0]: row[1] for row in session.execute(people)}
    by_person: dict[uuid.UUID, list[ClosedDay]] = defaultdict(list)
    for day in closed_days(session, study_id, first_day, last_day):
        by_person[day.participant_id].append(day)
    return [
        ClosedAmounts(
            profiles[participant_id],
            days[-1].local_date,
            len(days),
            [value for day in days if (value := _known(day, amounts, least_coverage)) is not None],
        )
        for participant_id, days in by_person.items()
    ]


def _known(day: ClosedDay, amounts: Mapping[tuple[uuid.UUID, date], Amount], least_coverage: float) -> float | None:
    """What was eaten on a day; None where too little is known of it."""
    if day.is_nothing:
        return 0.0
    amount = amounts.get((day.participant_id, day.local_date))
    if not day.is_whole or amount is None or amount.coverage is None or amount.coverage < least_coverage:
        return None
    return amount.value


def _component_by_day(
    session: Session,
    study_id: uuid.UUID,
    number: str,
    less: str | None,
    first_day: date | None,
    last_day: date | None,
) -> dict[tuple[uuid.UUID, date], Amount]:
    """(participant, day) -> sum over the day's records, and its coverage; days without records are absent."""
    record, content = EffectiveRecord, _contents(number)
    per_100_g: sa.ColumnElement[Any] = content.c.per_100_g
    query = sa.select(record.participant_id, record.local_date).outerjoin(content, content.c.food_id == record.food_id)
    if less is not None:
        other = _contents(less)
        per_100_g = per_100_g - other.c.per_100_g
        query = query.outerjoin(other, other.c.food_id == record.food_id)
    query = (
        query.add_columns(
            sa.func.sum(record.consumed_g * per_100_g / 100.0).label("amount"),
            coverage_of(per_100_g, record.consumed_g).label("coverage"),
        )
        .where(record.study_id == study_id, *within(record.local_date, first_day, last_day))
        .where(record.status != "rejected")
        .group_by(record.participant_id, record.local_date)
    )
    return {(row.participant_id, row.local_date): Amount(row.amount, row.coverage) for row in session.execute(query)}


def _contents(number: str) -> sa.Subquery:
    return (
        sa.select(FoodNutrient.food_id, FoodNutrient.per_100_g)
        .join(Component, Component.id == FoodNutrient.component_id)
        .where(Component.number == number)
        .subquery()
    )
