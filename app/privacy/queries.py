"""SQL of erasures: rows are deleted in the order of their references.

Each table declares which of its rows belong to a meal or a person, and which blobs they name
(db/base.py, `personal` and `blob`). A new table without a declaration fails
tests/integration/privacy/test_erasure_leaves_nothing.py.
"""

import uuid
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import date, datetime
from functools import cache
from typing import Literal

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.base import Base
from app.exports.made_file import MADE_FILES
from app.meals.stored.event_models import DayEvent, DiaryDay, MealEvent
from app.meals.stored.job_models import LIVE_STATES, Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import EffectiveRecord, Run, RunArtefact
from app.outbox.models import WebhookDelivery
from app.people.models import CameraCalibration, Device, Participant, Study
from app.tables import METADATA

Ids = sa.Select[uuid.UUID]
Owner = Literal["meal", "participant"]  # also the names of their tables


def participants_by_alias(session: Session, aliases: Collection[uuid.UUID]) -> dict[str, str]:
    """Return alias -> code of the participants who have one of these aliases."""
    query = sa.select(Participant.alias, Participant.code).where(Participant.alias.in_(aliases))
    return {str(alias): code for alias, code in session.execute(query)}


def meals_by_alias(session: Session, aliases: Collection[uuid.UUID]) -> dict[str, tuple[str, date]]:
    """Return alias -> (participant's code, local day) of the meals that have one of these aliases."""
    query = (
        sa.select(Meal.alias, Participant.code, Meal.local_date)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(Meal.alias.in_(aliases))
    )
    return {str(alias): (code, local_date) for alias, code, local_date in session.execute(query)}


def sandbox_participants_since(session: Session, before: datetime) -> list[uuid.UUID]:
    """Return the participants of sandbox studies with a phone or a meal that arrived before a time."""
    phones = sa.select(Device.participant_id).where(Device.enrolled_at < before)
    meals = sa.select(Meal.participant_id).where(Meal.received_at < before)
    query = (
        sa.select(Participant.id)
        .join(Study, Study.id == Participant.study_id)
        .where(Study.is_sandbox, sa.or_(Participant.id.in_(phones), Participant.id.in_(meals)))
        .order_by(Participant.id)
    )
    return list(session.scalars(query))


def lock_meals_of(session: Session, participant_id: uuid.UUID) -> list[Meal]:
    """Lock all meals of a participant, in the order of their ids."""
    query = (
        sa.select(Meal)
        .where(Meal.participant_id == participant_id)
        .order_by(Meal.id)
        .with_for_update()
    )
    return list(session.scalars(query.execution_options(populate_existing=True)))


def meals_of(participant_id: uuid.UUID) -> Ids:
    """Select the ids of a participant's meals."""
    return sa.select(Meal.id).where(Meal.participant_id == participant_id)


def record_ids(session: Session, meals: Ids) -> list[uuid.UUID]:
    """Return the ids of these meals' items that have a record."""
    return list(
        session.scalars(
            sa.select(EffectiveRecord.item_id).where(EffectiveRecord.meal_id.in_(meals))
        )
    )


def rows_of(model: type[Base], owner: Owner, ids: Ids) -> sa.ColumnElement[bool] | None:
    """Return the condition of a table's rows that belong to these meals or participants; None if none can."""
    conditions = []
    for name in model.personal.through if model.personal is not None else ():
        column = model.__table__.c[name]
        (key,) = column.foreign_keys
        if key.column.table.name == owner:
            conditions.append(column.in_(ids))
        elif (parent := _models().get(key.column.table.name)) is not None:
            of_parent = rows_of(parent, owner, ids)
            if of_parent is not None:
                conditions.append(column.in_(sa.select(key.column).where(of_parent)))
    return sa.or_(*conditions) if conditions else None


def delete_meals(session: Session, meals: Ids) -> dict[str, int]:
    """Delete meals and all rows that belong to them. Returns the number of rows by table."""
    counts = _delete_owned(session, "meal", meals)
    return counts | _delete_in_order(session, (Meal, Meal.id.in_(meals)))


def delete_participant(session: Session, participant_id: uuid.UUID) -> dict[str, int]:
    """Delete a participant whose meals are deleted. Returns the number of rows by table."""
    is_person = Participant.id == participant_id
    counts = _delete_owned(session, "participant", sa.select(Participant.id).where(is_person))
    return counts | _delete_in_order(session, (Participant, is_person))


def delete_identifying_rows(
    session: Session, participant_id: uuid.UUID, meals: Ids
) -> dict[str, int]:
    """Delete the webhook deliveries, calibrations and photographs' rows of a participant who is anonymised."""
    devices = sa.select(Device.id).where(Device.participant_id == participant_id)
    return _delete_in_order(
        session,
        (
            WebhookDelivery,
            sa.or_(
                WebhookDelivery.participant_id == participant_id, WebhookDelivery.meal_id.in_(meals)
            ),
        ),
        (CameraCalibration, CameraCalibration.device_id.in_(devices)),
        (MealImage, MealImage.meal_id.in_(meals)),
    )


def blob_keys_of(session: Session, meals: Ids) -> set[str]:
    """Return the keys of all blobs that rows of these meals name."""
    return {
        key
        for blob in _blob_columns()
        if (of_meals := rows_of(blob.model, "meal", meals)) is not None
        for key in session.scalars(sa.select(blob.key).where(of_meals))
    }


def delete_artefacts(session: Session, meals: Ids) -> list[str]:
    """Delete the rows of derived pictures and points. Returns the keys of their blobs."""
    runs = sa.select(Run.id).where(Run.meal_id.in_(meals))
    return list(
        session.scalars(
            sa.delete(RunArtefact)
            .where(RunArtefact.run_id.in_(runs))
            .returning(RunArtefact.blob_key)
        )
    )


def mark_images_erased(session: Session, meals: Ids, now: datetime) -> list[str]:
    """Mark photographs as erased. Returns the keys of their blobs."""
    return list(
        session.scalars(
            sa.update(MealImage)
            .where(MealImage.meal_id.in_(meals), MealImage.erased_at.is_(None))
            .values(erased_at=now)
            .returning(MealImage.blob_key)
        )
    )


def touch_meals(session: Session, meals: Ids) -> None:
    """Increase each meal's version, so that its ETag changes."""
    session.execute(
        sa.update(Meal)
        .where(Meal.id.in_(meals))
        .values(version=Meal.version + 1)
        .execution_options(synchronize_session=False)
    )


def touch_records_and_days(session: Session, participant_id: uuid.UUID, change_seq: int) -> None:
    """Mark a participant's records and days as changed, so that clients that pull changes get the new code."""
    for table in (EffectiveRecord, DiaryDay):
        session.execute(
            sa.update(table)
            .where(table.participant_id == participant_id)
            .values(change_seq=change_seq)
            .execution_options(synchronize_session=False)
        )


def day_ids(session: Session, participant_id: uuid.UUID) -> list[uuid.UUID]:
    """Return the ids of a participant's days."""
    return list(
        session.scalars(sa.select(DiaryDay.id).where(DiaryDay.participant_id == participant_id))
    )


def events_of(session: Session, meals: Ids) -> Iterator[MealEvent]:
    """Stream the events of these meals."""
    query = (
        sa.select(MealEvent)
        .where(MealEvent.meal_id.in_(meals))
        .order_by(MealEvent.meal_id, MealEvent.sequence)
    )
    yield from session.scalars(query)


def day_events_of(session: Session, participant_id: uuid.UUID) -> list[DayEvent]:
    """Return a participant's day events."""
    query = sa.select(DayEvent).where(DayEvent.participant_id == participant_id)
    return list(
        session.scalars(query.order_by(DayEvent.local_date, DayEvent.created_at, DayEvent.id))
    )


def studies_with_retention(session: Session) -> list[Study]:
    """Return the studies with a retention time."""
    return list(
        session.scalars(
            sa.select(Study).where(Study.retention_days.is_not(None)).order_by(Study.id)
        )
    )


def meals_with_old_pictures(
    session: Session, study_id: uuid.UUID, before: datetime, limit: int
) -> list[uuid.UUID]:
    """Lock meals received before a time that still have photographs or derived pictures.

    Returns their ids.
    """
    has_image = sa.exists().where(MealImage.meal_id == Meal.id, MealImage.erased_at.is_(None))
    has_artefact = sa.exists().where(Run.meal_id == Meal.id, RunArtefact.run_id == Run.id)
    query = (
        sa.select(Meal.id)
        .where(
            Meal.study_id == study_id, Meal.received_at < before, sa.or_(has_image, has_artefact)
        )
        .order_by(Meal.id)
        .limit(limit)
        .with_for_update()
    )
    return list(session.scalars(query))


def ids_in(meal_ids: Collection[uuid.UUID]) -> Ids:
    """Select these meals' ids."""
    return sa.select(Meal.id).where(Meal.id.in_(meal_ids))


def meal_ids(session: Session) -> Iterator[uuid.UUID]:
    """Stream the ids of all meals."""
    yield from session.scalars(sa.select(Meal.id).execution_options(yield_per=1000))


def is_named(session: Session, key: str) -> bool:
    """Whether a row needs the blob; of a key that ends with a slash, whether its meal exists."""
    if key.endswith("/"):
        return bool(session.scalar(sa.select(sa.exists().where(Meal.id == _meal_of(key)))))
    named = (sa.exists().where(blob.key == key, blob.is_kept) for blob in _blob_columns())
    return bool(session.scalar(sa.select(sa.or_(*named))))


def keys_of_studies(session: Session, keys: Collection[str]) -> set[str]:
    """Return the keys (`study/...`, or `made/exports/study/...` of files) whose study exists."""
    study_of_key = {key: _study_of(key) for key in keys}
    study_ids = {study_id for study_id in study_of_key.values() if study_id is not None}
    existing = set(session.scalars(sa.select(Study.id).where(Study.id.in_(study_ids))))
    return {key for key, study_id in study_of_key.items() if study_id in existing}


def needed_keys(session: Session, keys: Collection[str]) -> set[str]:
    """Return the keys that a row names, or that a live job may name later.

    keys: at most IN_A_STATEMENT.

    A job seals its result and pictures before it commits them, possibly days later if its worker
    dies in between.
    """
    meal_of = {key: _meal_of(key) for key in keys}
    meals = {meal_id for meal_id in meal_of.values() if meal_id is not None}
    named = []
    for blob in _blob_columns():
        of_meals = rows_of(blob.model, "meal", ids_in(meals))
        condition = of_meals if of_meals is not None else blob.key.in_(keys)
        named.append(sa.select(blob.key).where(condition, blob.is_kept))
    # read first: a job that ends in between has its run by the time of the second query
    in_progress = set(
        session.scalars(
            sa.select(Job.meal_id).where(Job.meal_id.in_(meals), Job.state.in_(LIVE_STATES))
        )
    )
    needed = set(session.scalars(sa.union_all(*named))) & set(keys)
    return needed | {key for key, meal_id in meal_of.items() if meal_id in in_progress}


def stream_meals_of(session: Session, participant_id: uuid.UUID) -> Iterator[Meal]:
    """Stream a participant's meals in the order of eating, one at a time in memory."""
    query = (
        sa.select(Meal.id)
        .where(Meal.participant_id == participant_id)
        .order_by(Meal.captured_at, Meal.id)
    )
    # ids only: expunge_all would break a stream of rows
    for meal_id in list(session.scalars(query)):
        yield session.get_one(Meal, meal_id)
        session.expunge_all()


def images_of_participant(
    session: Session, participant_id: uuid.UUID
) -> Iterator[tuple[MealImage, uuid.UUID]]:
    """Stream (photograph, the phone's id of its meal), including erased photographs."""
    query = (
        sa.select(MealImage, Meal.client_id)
        .join(Meal, Meal.id == MealImage.meal_id)
        .where(Meal.participant_id == participant_id)
        .order_by(Meal.captured_at, Meal.id, MealImage.slot)
    )
    for row in session.execute(query.execution_options(yield_per=100)):
        yield row[0], row[1]


def exported_rows(
    session: Session, owner: Owner, owner_id: uuid.UUID
) -> Iterator[tuple[str, list[Base]]]:
    """Yield (name, rows) of all rows that belong to a meal, or to a participant without meals; not tokens and jobs."""
    parent = Meal if owner == "meal" else Participant
    for model in _models().values():
        of_owner = rows_of(model, owner, sa.select(parent.id).where(parent.id == owner_id))
        if model.personal is None or model.personal.export_as is None or of_owner is None:
            continue
        order = (
            [model.__table__.c[model.personal.order_by]]
            if model.personal.order_by is not None
            else []
        )
        yield (
            model.personal.export_as,
            list(session.scalars(sa.select(model).where(of_owner).order_by(*order))),
        )


@cache
def _models() -> dict[str, type[Base]]:
    """Return the tables of personal rows by name; tables come after those that they refer to."""
    models = {mapper.class_.__tablename__: mapper.class_ for mapper in Base.registry.mappers}
    return {
        table.name: models[table.name]
        for table in METADATA.sorted_tables
        if models[table.name].personal is not None
    }


@dataclass(frozen=True, slots=True)
class _BlobColumn:
    """A column that names blobs. is_kept: condition of rows that still need theirs."""

    model: type[Base]
    key: sa.ColumnElement[str]
    is_kept: sa.ColumnElement[bool]


@cache
def _blob_columns() -> list[_BlobColumn]:
    blob_columns = []
    for mapper in Base.registry.mappers:
        model, columns = mapper.class_, mapper.local_table.c
        if (blob := model.blob) is not None:
            is_kept = columns[blob.erased_at].is_(None) if blob.erased_at is not None else sa.true()
            blob_columns.append(_BlobColumn(model, columns[blob.key], is_kept))
    return blob_columns


def _delete_owned(session: Session, owner: Owner, ids: Ids) -> dict[str, int]:
    """Delete the rows of all tables that belong to these meals or participants, referring tables first."""
    steps = ((model, rows_of(model, owner, ids)) for model in reversed(_models().values()))
    return _delete_in_order(
        session, *((model, condition) for model, condition in steps if condition is not None)
    )


def _delete_in_order(
    session: Session, *steps: tuple[type[Base], sa.ColumnElement[bool]]
) -> dict[str, int]:
    session.flush()
    connection = session.connection()
    counts = {
        model.__tablename__: connection.execute(sa.delete(model).where(condition)).rowcount
        for model, condition in steps
    }
    session.expire_all()
    return counts


def _study_of(key: str) -> uuid.UUID | None:
    parts = key.split("/")
    index = 2 if parts[0] == MADE_FILES else 0
    return _uuid_or_none(parts[index]) if len(parts) > index else None


def _meal_of(key: str) -> uuid.UUID | None:
    parts = key.split("/")
    return _uuid_or_none(parts[1]) if len(parts) > 2 else None


def _uuid_or_none(text: str) -> uuid.UUID | None:
    try:
        return uuid.UUID(text)
    except ValueError:
        return None
