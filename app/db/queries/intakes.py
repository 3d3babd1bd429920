"""SQL of intakes: means over participants' closed days, and a component of the food table by day."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import Component, DiaryDay, EffectiveRecord, FoodNutrient, Meal, Participant
from app.db.models.record import HEADLINE_COLUMNS
from app.db.queries.days import (
    FULL,
    Amount,
    DayFilter,
    coverage_of,
    days_with_sums,
    filtered,
    is_unmeasured_meal,
    keys_of,
)


class MeanAmount(NamedTuple):
    """A mean daily amount over closed days, on how many of them it is known, and the mean of their coverages.

    value: None where it is known on no closed day. coverage: None where one of the days has none.
    """

    value: float | None
    days: int
    coverage: float | None


class ClosedDay(NamedTuple):
    """is_nothing: nothing was eaten. is_whole: nothing was, or the eaten grams of everything are known and final."""

    participant_id: uuid.UUID
    local_date: date
    is_nothing: bool
    is_whole: bool


@dataclass(frozen=True, slots=True)
class IntakeRow:
    """A participant's mean daily intake over closed days.

    open_days: days with a meal or a word that are not closed, left out. first_day, last_day: of all their days.
    days: with a meal or a word. whole_days: closed days of which everything is measured, final, and has an energy;
    whole_energy_kcal: their mean energy.
    """

    participant_id: uuid.UUID
    participant_code: str
    profile: dict[str, Any] | None
    first_day: date
    last_day: date
    days: int
    closed_days: int
    open_days: int
    unmeasured_meals: int
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int
    whole_days: int
    whole_energy_kcal: float | None
    means: Mapping[str, MeanAmount]


def page_of_intakes(
    session: Session,
    study_id: uuid.UUID,
    *,
    first_day: date | None,
    last_day: date | None,
    after: str | None,
    limit: int,
) -> list[IntakeRow]:
    """Mean intakes of at most `limit` participants who have a day, by code, those behind `after`."""
    chosen = DayFilter(study_ids=frozenset({study_id}), first_day=first_day, last_day=last_day)
    keys = keys_of(chosen, None).subquery()
    some = (
        sa.select(Participant.id)
        .where(Participant.study_id == study_id, Participant.id.in_(sa.select(keys.c.participant_id)))
        .order_by(Participant.code)
        .limit(limit)
    )
    if after is not None:
        some = some.where(Participant.code > after)
    people = some.cte("people")
    page = (
        sa.select(keys.c.participant_id, keys.c.local_date)
        .join(people, people.c.id == keys.c.participant_id)
        .cte("page")
    )
    day = days_with_sums(page).subquery()
    is_closed = day.c.status == "closed"
    is_empty = sa.and_(day.c.meals > 0, day.c.item_count == 0, day.c.unmeasured_meals == 0)
    is_nothing = sa.and_(is_closed, sa.or_(sa.and_(day.c.said_nothing, day.c.meals == 0), is_empty))
    is_final = day.c.provisional == 0
    is_whole = sa.and_(day.c.item_count > 0, day.c.unmeasured == 0, day.c.unmeasured_meals == 0, is_final)
    is_measured = sa.and_(is_closed, is_whole, day.c.energy_kcal_coverage >= FULL)
    closed_sums = [
        sa.func.coalesce(sa.func.sum(sa.case((is_closed, day.c[name]), else_=0)), 0).label(name)
        for name in ("unmeasured_meals", "unmeasured", "provisional", "leftovers_unknown")
    ]
    whole_kcal = sa.case((is_nothing, 0.0), (is_measured, day.c.energy_kcal))
    means: list[Any] = []
    for name in HEADLINE_COLUMNS:
        amount = sa.case((is_nothing, 0.0), (is_closed, day.c[name]))
        coverage = sa.case((is_nothing, 1.0), (is_closed, day.c[f"{name}_coverage"]))
        closed_days = sa.func.count(sa.case((is_closed, 1)))
        means += [
            sa.func.avg(amount).label(name),
            sa.func.count(amount).label(f"{name}_days"),
            sa.case((sa.func.count(coverage) == closed_days, sa.func.avg(coverage))).label(f"{name}_coverage"),
        ]
    query = (
        sa.select(
            day.c.participant_id,
            day.c.participant_code,
            sa.func.min(day.c.local_date).label("first_day"),
            sa.func.max(day.c.local_date).label("last_day"),
            sa.func.count().label("days"),
            sa.func.count(sa.case((is_closed, 1))).label("closed_days"),
            *closed_sums,
            sa.func.count(whole_kcal).label("whole_days"),
            sa.func.avg(whole_kcal).label("whole_kcal"),
            *means,
        )
        .group_by(day.c.participant_id, day.c.participant_code)
        .order_by(day.c.participant_code)
    )
    rows = session.execute(query).all()
    profiles: dict[uuid.UUID, dict[str, Any] | None] = dict(
        session.execute(
            sa.select(Participant.id, Participant.profile).where(Participant.id.in_([row[0] for row in rows]))
        ).all()
    )
    return [_intake_row(row, profiles[row[0]]) for row in rows]


def closed_days(session: Session, chosen: DayFilter) -> list[ClosedDay]:
    """The closed days of the filter."""
    record = EffectiveRecord
    same_day = (record.participant_id == DiaryDay.participant_id, record.local_date == DiaryDay.local_date)
    holds = (*same_day, record.status != "rejected")
    is_there = (
        Meal.participant_id == DiaryDay.participant_id,
        Meal.local_date == DiaryDay.local_date,
    )
    has_meal, has_item = sa.exists().where(*is_there), sa.exists().where(*holds)
    is_known = ~sa.exists().where(*is_there, is_unmeasured_meal())
    is_empty = sa.and_(has_meal, ~has_item, is_known)
    is_nothing = sa.or_(sa.and_(DiaryDay.ate_nothing, ~has_meal), is_empty)
    is_open = sa.or_(record.consumed_g.is_(None), record.provisional)
    is_measured = sa.and_(has_item, ~sa.exists().where(*holds, is_open), is_known)
    query = sa.select(DiaryDay.participant_id, DiaryDay.local_date, is_nothing, sa.or_(is_nothing, is_measured))
    query = filtered(query, DiaryDay.study_id, DiaryDay.participant_id, DiaryDay.local_date, chosen)
    query = query.where(DiaryDay.status == "closed").order_by(DiaryDay.participant_id, DiaryDay.local_date)
    return [ClosedDay(row[0], row[1], bool(row[2]), bool(row[3])) for row in session.execute(query)]


def profiles_of(session: Session, study_id: uuid.UUID) -> dict[uuid.UUID, dict[str, Any] | None]:
    """Participant -> profile, of a whole study."""
    query = sa.select(Participant.id, Participant.profile).where(Participant.study_id == study_id)
    return {row[0]: row[1] for row in session.execute(query)}


def component_by_day(
    session: Session, chosen: DayFilter, number: str, less: str | None
) -> dict[tuple[uuid.UUID, date], Amount]:
    """(participant, day) -> sum of a component of the food table over the day's records, and its coverage.

    number: the component; less: another that is taken off it (fibre from carbohydrate), unknown where that is unknown.
    Days without records are absent.
    """
    record, content = EffectiveRecord, _contents(number)
    per_100_g: sa.ColumnElement[Any] = content.c.per_100_g
    query = sa.select(record.participant_id, record.local_date).outerjoin(content, content.c.food_id == record.food_id)
    if less is not None:
        other = _contents(less)
        per_100_g = per_100_g - other.c.per_100_g
        query = query.outerjoin(other, other.c.food_id == record.food_id)
    query = query.add_columns(
        sa.func.sum(record.consumed_g * per_100_g / 100.0), coverage_of(per_100_g, record.consumed_g)
    )
    query = filtered(query, record.study_id, record.participant_id, record.local_date, chosen)
    query = query.where(record.status != "rejected").group_by(record.participant_id, record.local_date)
    rows: sa.Result[*tuple[Any, ...]] = session.execute(query)
    return {(row[0], row[1]): Amount(row[-2], row[-1]) for row in rows}


def _contents(number: str) -> sa.Subquery:
    return (
        sa.select(FoodNutrient.food_id, FoodNutrient.per_100_g)
        .join(Component, Component.id == FoodNutrient.component_id)
        .where(Component.number == number)
        .subquery()
    )


def _intake_row(row: sa.Row[*tuple[Any, ...]], profile: dict[str, Any] | None) -> IntakeRow:
    values = row._mapping  # noqa: SLF001  # SQLAlchemy's own way to a row by name
    return IntakeRow(
        participant_id=values["participant_id"],
        participant_code=values["participant_code"],
        profile=profile,
        first_day=values["first_day"],
        last_day=values["last_day"],
        days=values["days"],
        closed_days=values["closed_days"],
        open_days=values["days"] - values["closed_days"],
        unmeasured_meals=int(values["unmeasured_meals"]),
        unmeasured_items=int(values["unmeasured"]),
        provisional_items=int(values["provisional"]),
        leftovers_unknown_items=int(values["leftovers_unknown"]),
        whole_days=values["whole_days"],
        whole_energy_kcal=values["whole_kcal"],
        means={
            name: MeanAmount(values[name], values[f"{name}_days"], values[f"{name}_coverage"])
            for name in HEADLINE_COLUMNS
        },
    )
