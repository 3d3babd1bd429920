"""SQL of runs, items and effective records. Records page by the immutable (captured_at, item id)."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import (
    DiaryDay,
    EffectiveRecord,
    Food,
    FoodRelease,
    Meal,
    Participant,
    Run,
    RunArtefact,
    Study,
)
from app.db.queries import diary


@dataclass(frozen=True, slots=True)
class RecordFilter:
    """Which records: None leaves a filter out. first_day and last_day are local days, both included."""

    study_code: str | None = None
    participant_code: str | None = None
    participant_id: uuid.UUID | None = None
    study_ids: frozenset[uuid.UUID] | None = None
    first_day: date | None = None
    last_day: date | None = None
    food_key: str | None = None
    status: str | None = None


@dataclass(frozen=True, slots=True)
class RecordRow:
    """An effective record with the names that go with it, and its day's.

    received_at: when the first of the meal arrived. first_day: the participant's day 1.
    """

    record: EffectiveRecord
    meal_client_id: uuid.UUID
    time_zone: str
    study_code: str
    participant_code: str
    food: Food | None
    food_release: str | None
    received_at: datetime
    day_status: str
    first_day: date | None


def page_of_records(
    session: Session, chosen: RecordFilter, *, after: tuple[datetime, uuid.UUID] | None, limit: int
) -> list[RecordRow]:
    """At most `limit` records in the order of (captured_at, item id), those behind `after`."""
    record = EffectiveRecord
    query = _rows().order_by(record.captured_at, record.item_id).limit(limit)
    conditions = {
        Study.code: chosen.study_code,
        Participant.code: chosen.participant_code,
        record.participant_id: chosen.participant_id,
        record.status: chosen.status,
        Food.key: chosen.food_key,
    }
    for column, value in conditions.items():
        if value is not None:
            query = query.where(column == value)
    if chosen.first_day is not None:
        query = query.where(record.local_date >= chosen.first_day)
    if chosen.last_day is not None:
        query = query.where(record.local_date <= chosen.last_day)
    if chosen.study_ids is not None:
        query = query.where(record.study_id.in_(chosen.study_ids))
    if after is not None:
        query = query.where(sa.tuple_(record.captured_at, record.item_id) > sa.tuple_(*_bound(after)))
    return _with_days(session, query)


def rows_of_records(
    session: Session, where: Sequence[sa.ColumnElement[bool]], order: Sequence[Any], limit: int
) -> list[RecordRow]:
    """At most `limit` records that fulfil the conditions, in this order."""
    return _with_days(session, _rows().where(*where).order_by(*order).limit(limit))


def _with_days(session: Session, query: sa.Select[*tuple[Any, ...]]) -> list[RecordRow]:
    rows: list[tuple[Any, ...]] = [tuple(row) for row in session.execute(query)]
    first = diary.first_days(session, {row[0].participant_id for row in rows})
    return [RecordRow(*(*row, first.get(row[0].participant_id))) for row in rows]


def last_run(session: Session, meal_id: uuid.UUID, purpose: str = "meal") -> Run | None:
    """The newest run of the meal's own pair, or of its after-meal pair."""
    query = (
        sa.select(Run)
        .where(Run.meal_id == meal_id, Run.purpose == purpose)
        .order_by(Run.created_at.desc(), Run.id)
        .limit(1)
    )
    return session.scalars(query).one_or_none()


def artefacts_of(session: Session, run_id: uuid.UUID) -> list[RunArtefact]:
    """A run's pictures and point clouds by name."""
    return list(session.scalars(sa.select(RunArtefact).where(RunArtefact.run_id == run_id).order_by(RunArtefact.name)))


def next_change_seq(session: Session, study_id: uuid.UUID) -> int:
    """Count a change of the study; the counter's row stays locked until commit, so numbers appear in order."""
    query = (
        sa.update(Study).where(Study.id == study_id).values(change_seq=Study.change_seq + 1).returning(Study.change_seq)
    )
    return session.execute(query).scalar_one()


def _rows() -> sa.Select[*tuple[Any, ...]]:
    record = EffectiveRecord
    return (
        sa.select(
            record,
            Meal.client_id,
            Meal.time_zone,
            Study.code,
            Participant.code,
            Food,
            FoodRelease.name + " " + FoodRelease.version,
            Meal.received_at,
            sa.func.coalesce(DiaryDay.status, "open"),
        )
        .join(Meal, Meal.id == record.meal_id)
        .join(Study, Study.id == record.study_id)
        .join(Participant, Participant.id == record.participant_id)
        .outerjoin(
            DiaryDay,
            sa.and_(DiaryDay.participant_id == record.participant_id, DiaryDay.local_date == record.local_date),
        )
        .outerjoin(Food, Food.id == record.food_id)
        .outerjoin(FoodRelease, FoodRelease.id == Food.release_id)
    )


def _bound(after: tuple[datetime, uuid.UUID]) -> tuple[sa.BindParameter[Any], sa.BindParameter[Any]]:
    captured_at, item_id = after
    record = EffectiveRecord
    return (
        sa.bindparam(None, captured_at, type_=record.captured_at.type),
        sa.bindparam(None, item_id, type_=record.item_id.type),
    )
