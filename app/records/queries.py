"""SQL of runs, jobs, items and effective records.

Records page by the immutable (captured_at, item id).
"""

import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session, defer

from app.db.statements import AnyColumn, AnyQuery
from app.foods.models import Food, FoodRelease
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import DayStatus, DiaryDay
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.queries import MEAL_ID, first_days
from app.meals.stored.record_models import (
    EffectiveRecord,
    Item,
    ItemFood,
    Recompute,
    Run,
    RunArtefact,
)
from app.people.models import Participant, Study
from app.records.page_queries import Key, holds, search_of

# Statements of each GET of a meal, made once: that takes longer than to execute them
OF_MEAL: sa.BindParameter[uuid.UUID] = sa.bindparam(MEAL_ID, type_=sa.Uuid())
RUNS = sa.select(Run).where(Run.meal_id == OF_MEAL).order_by(Run.created_at, Run.id.desc())
ITEMS = (
    sa.select(EffectiveRecord, Item, ItemFood, Food)
    .join(Item, Item.id == EffectiveRecord.item_id)
    .outerjoin(
        ItemFood,
        sa.and_(
            ItemFood.item_id == EffectiveRecord.item_id,
            ItemFood.version == EffectiveRecord.food_version,
        ),
    )
    .outerjoin(Food, Food.id == EffectiveRecord.food_id)
    .where(EffectiveRecord.meal_id == OF_MEAL)
    .order_by(Item.position, Item.id)
)
HAS_RESULTS = sa.select(
    sa.or_(
        sa.exists().where(Run.meal_id == OF_MEAL),
        sa.exists().where(EffectiveRecord.meal_id == OF_MEAL),
    )
)


class FoodName(NamedTuple):
    """A food by its key, and by its name in the version that a record holds."""

    key: str
    name: str


@dataclass(frozen=True, slots=True)
class RecordRow:
    """An effective record with the names that go with it, and its day's.

    received_at: when the first of the meal arrived
    first_day: the participant's day 1
    """

    record: EffectiveRecord
    meal_client_id: uuid.UUID
    utc_offset_minutes: int
    time_zone: str
    study_code: str
    participant_code: str
    food_release: str | None
    received_at: datetime
    day_status: DayStatus
    food: FoodName | None
    first_day: date | None


class ItemRow(NamedTuple):
    """An effective record, its item, and the food that it is taken for, as it was weighed."""

    record: EffectiveRecord
    item: Item
    food_assignment: ItemFood | None
    food: Food | None


def page_of_records(
    session: Session, chosen: RowFilter, *, after: Key | None, limit: int
) -> list[RecordRow]:
    """At most `limit` records in the order of (captured_at, item id), those behind `after`."""
    search = search_of(session, chosen)
    if search is None:
        return []
    return rows_of_page(session, search.page(after, limit))


def rows_of_page(session: Session, page: sa.CTE) -> list[RecordRow]:
    """The records of a page of keys, captured_at and item_id, in this order."""
    query = _rows(page.join(EffectiveRecord, EffectiveRecord.item_id == page.c.item_id))
    return _with_days(session, query.order_by(page.c.captured_at, page.c.item_id))


def rows_of_records(
    session: Session,
    where: Sequence[sa.ColumnElement[bool]],
    order: Sequence[AnyColumn],
    limit: int,
) -> list[RecordRow]:
    """At most `limit` records that fulfil the conditions, in this order."""
    return _with_days(session, _rows(EffectiveRecord).where(*where).order_by(*order).limit(limit))


def runs_of(session: Session, meal_id: uuid.UUID) -> list[Run]:
    """Return all runs of a meal, of every purpose, oldest first."""
    return list(
        session.scalars(
            sa.select(Run).where(Run.meal_id == meal_id).order_by(Run.created_at, Run.id)
        )
    )


def jobs_of(session: Session, meal_id: uuid.UUID) -> list[Job]:
    """Return all jobs of a meal, oldest first. A run has its job's id."""
    return list(
        session.scalars(
            sa.select(Job).where(Job.meal_id == meal_id).order_by(Job.enqueued_at, Job.id)
        )
    )


def recomputes_of(session: Session, meal_id: uuid.UUID) -> list[Recompute]:
    """Return the recomputations that changed the food version, density or edible share of an item of the meal."""
    ids = (
        sa.select(ItemFood.recompute_id)
        .join(Item, Item.id == ItemFood.item_id)
        .where(Item.meal_id == meal_id, ItemFood.recompute_id.is_not(None))
    )
    return list(
        session.scalars(
            sa.select(Recompute).where(Recompute.id.in_(ids)).order_by(Recompute.started_at)
        )
    )


@dataclass(frozen=True, slots=True)
class StudyRecords:
    """Number of a study's records of a food, without rejected ones."""

    study_id: uuid.UUID
    code: str
    name: str
    records: int


def records_by_study(
    session: Session,
    food_ids: Collection[int],
    study_ids: Collection[uuid.UUID] | None,
    *,
    most: int,
    studies: int,
) -> list[StudyRecords]:
    """Return the first `studies` of these studies (None: of all) by code, with at most `most` records of these foods.

    Rejected records do not count. Each study is read in the index of a food's records, no further
    than `most`.
    """
    counted = (
        sa.select(sa.literal(1))
        .where(
            EffectiveRecord.food_id.in_(food_ids),
            EffectiveRecord.study_id == Study.id,
            holds(EffectiveRecord),
        )
        .limit(most)
        .correlate(Study)
        .subquery()
    )
    records = sa.select(sa.func.count()).select_from(counted).scalar_subquery()
    query = sa.select(Study.id, Study.code, Study.name, records).order_by(Study.code).limit(studies)
    if study_ids is not None:
        query = query.where(Study.id.in_(study_ids))
    return [StudyRecords(*row) for row in session.execute(query)]


def _with_days(session: Session, query: AnyQuery) -> list[RecordRow]:
    rows = session.execute(query).all()
    first = first_days(session, {row[0].participant_id for row in rows})
    return [
        RecordRow(
            record=record,
            meal_client_id=meal,
            utc_offset_minutes=offset,
            time_zone=time_zone,
            study_code=study,
            participant_code=participant,
            food=FoodName(food_key, food_name) if food_key is not None else None,
            food_release=food_release,
            received_at=received_at,
            day_status=day_status,
            first_day=first.get(record.participant_id),
        )
        for (
            record,
            food_key,
            food_name,
            meal,
            offset,
            time_zone,
            study,
            participant,
            food_release,
            received_at,
            day_status,
        ) in rows
    ]


def has_results(session: Session, meal_id: uuid.UUID) -> bool:
    """Return whether the meal has a run or a record."""
    return session.execute(HAS_RESULTS, {MEAL_ID: meal_id}).scalar_one()


def last_runs(session: Session, meal_id: uuid.UUID) -> dict[str, Run]:
    """Purpose -> the newest run of it."""
    return {run.purpose: run for run in session.scalars(RUNS, {MEAL_ID: meal_id})}


def items_of_meal(session: Session, meal_id: uuid.UUID) -> list[ItemRow]:
    """The records of a meal with what they are of, in the order of the items."""
    return [ItemRow(*row) for row in session.execute(ITEMS, {MEAL_ID: meal_id})]


def artefacts_of(session: Session, run_id: uuid.UUID) -> list[RunArtefact]:
    """A run's pictures and point clouds by name."""
    return list(
        session.scalars(
            sa.select(RunArtefact).where(RunArtefact.run_id == run_id).order_by(RunArtefact.name)
        )
    )


def next_change_seq(session: Session, study_id: uuid.UUID) -> int:
    """Count a change of the study; the counter's row stays locked until commit, so numbers appear in order."""
    query = (
        sa.update(Study)
        .where(Study.id == study_id)
        .values(change_seq=Study.change_seq + 1)
        .returning(Study.change_seq)
    )
    return session.execute(query).scalar_one()


def _rows(source: sa.FromClause | type[EffectiveRecord]) -> AnyQuery:
    """Records, without their details, and what goes with them, from a source that has EffectiveRecord in it."""
    record = EffectiveRecord
    return (
        sa.select(
            record,
            Food.key,
            Food.name,
            Meal.client_id,
            Meal.utc_offset_minutes,
            Meal.time_zone,
            Study.code,
            Participant.code,
            FoodRelease.name + " " + FoodRelease.version,
            Meal.received_at,
            sa.func.coalesce(DiaryDay.status, "open"),
        )
        .select_from(source)
        .join(Meal, Meal.id == record.meal_id)
        .join(Study, Study.id == record.study_id)
        .join(Participant, Participant.id == record.participant_id)
        .outerjoin(
            DiaryDay,
            sa.and_(
                DiaryDay.participant_id == record.participant_id,
                DiaryDay.local_date == record.local_date,
            ),
        )
        .outerjoin(Food, Food.id == record.food_id)
        .outerjoin(FoodRelease, FoodRelease.id == Food.release_id)
        .options(defer(record.details, raiseload=True))
    )
