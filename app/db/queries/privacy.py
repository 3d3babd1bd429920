"""SQL of erasures: rows go in the order of their references; tombstones, receipts, intents and the audit log.

Which rows belong to a meal or a person stands here and nowhere else; a table that a later version adds and that is not
named here fails tests/integration/services/test_erasure_leaves_nothing.py.
"""

import uuid
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import (
    AccessToken,
    AuditEvent,
    Base,
    BlobDeletion,
    CameraCalibration,
    DayEvent,
    DayMark,
    DaySum,
    Device,
    DiaryDay,
    EffectiveRecord,
    Enrolment,
    ErasureReceipt,
    Export,
    IndexEntry,
    Item,
    ItemCandidate,
    ItemFood,
    ItemIdentification,
    ItemMeasure,
    Job,
    Leftover,
    Meal,
    MealEvent,
    MealImage,
    Participant,
    ReleaseFile,
    Run,
    RunArtefact,
    Study,
    Tombstone,
    WebhookDelivery,
)
from app.db.queries import study_day_sums
from app.db.queries.jobs import LIVE_STATES

IN_A_STATEMENT = 500  # values in one IN (...); SQLite takes 32,766
MADE_FILES = "made"  # before the study in keys of files of a whole study (services/made_file.py)
UUID_CHARACTERS = 36


Ids = sa.Select[uuid.UUID]


@dataclass(frozen=True, slots=True)
class AuditFilter:
    """Which events: None leaves a filter out. since is included, until is not."""

    study_id: uuid.UUID | None = None
    action: str | None = None
    since: datetime | None = None
    until: datetime | None = None


def lock_participant(session: Session, participant_id: uuid.UUID) -> Participant | None:
    """The participant, locked against everything, new meals and devices included."""
    query = sa.select(Participant).where(Participant.id == participant_id).with_for_update()
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def join_participant(session: Session, participant_id: uuid.UUID | None) -> Participant | None:
    """The participant, so that something may be added to them: waits for a withdrawal under way."""
    query = sa.select(Participant).where(Participant.id == participant_id).with_for_update(read=True, key_share=True)
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def lock_meals_of(session: Session, participant_id: uuid.UUID) -> list[Meal]:
    """All meals of a participant, locked, in the order of their ids."""
    query = sa.select(Meal).where(Meal.participant_id == participant_id).order_by(Meal.id).with_for_update()
    return list(session.scalars(query.execution_options(populate_existing=True)))


def meals_of(participant_id: uuid.UUID) -> Ids:
    """The ids of a participant's meals, as a query."""
    return sa.select(Meal.id).where(Meal.participant_id == participant_id)


def one_meal(meal_id: uuid.UUID) -> Ids:
    """The id of a meal that is there, as a query."""
    return sa.select(Meal.id).where(Meal.id == meal_id)


def record_ids(session: Session, meals: Ids) -> list[uuid.UUID]:
    """The items of these meals that have a record."""
    return list(session.scalars(sa.select(EffectiveRecord.item_id).where(EffectiveRecord.meal_id.in_(meals))))


def delete_meals(session: Session, meals: Ids) -> dict[str, int]:
    """Remove meals and all that hangs on them; table -> rows."""
    items = sa.select(Item.id).where(Item.meal_id.in_(meals))
    runs = sa.select(Run.id).where(Run.meal_id.in_(meals))
    _delete_day_sums(session, meals)
    return _delete_in_order(
        session,
        (EffectiveRecord, EffectiveRecord.meal_id.in_(meals)),
        (IndexEntry, IndexEntry.item_id.in_(items)),
        (ItemIdentification, ItemIdentification.item_id.in_(items)),
        (ItemCandidate, ItemCandidate.item_id.in_(items)),
        (ItemFood, ItemFood.item_id.in_(items)),
        (ItemMeasure, ItemMeasure.item_id.in_(items)),
        (Leftover, sa.or_(Leftover.after_item_id.in_(items), Leftover.item_id.in_(items))),
        (Item, Item.meal_id.in_(meals)),
        (RunArtefact, RunArtefact.run_id.in_(runs)),
        (Run, Run.meal_id.in_(meals)),
        (WebhookDelivery, WebhookDelivery.meal_id.in_(meals)),
        (Job, Job.meal_id.in_(meals)),
        (MealEvent, MealEvent.meal_id.in_(meals)),
        (MealImage, MealImage.meal_id.in_(meals)),
        (Meal, Meal.id.in_(meals)),
    )


def delete_participant(session: Session, participant_id: uuid.UUID) -> dict[str, int]:
    """Remove a participant whose meals are gone; table -> rows."""
    devices = sa.select(Device.id).where(Device.participant_id == participant_id)
    counts = _delete_in_order(
        session,
        (WebhookDelivery, WebhookDelivery.participant_id == participant_id),
        (DiaryDay, DiaryDay.participant_id == participant_id),
        (DayEvent, DayEvent.participant_id == participant_id),
        (CameraCalibration, CameraCalibration.device_id.in_(devices)),
        (AccessToken, AccessToken.device_id.in_(devices)),
        (Device, Device.participant_id == participant_id),
        (Enrolment, Enrolment.participant_id == participant_id),
    )
    of_person = (DaySum.participant_id == participant_id, DayMark.participant_id == participant_id)
    _forget_study_days(session, DaySum, of_person[0])
    _forget_study_days(session, DayMark, of_person[1])
    _delete_in_order(session, *zip((DaySum, DayMark), of_person, strict=True))  # those before have left marks
    return counts | _delete_in_order(session, (Participant, Participant.id == participant_id))


def _delete_day_sums(session: Session, meals: Ids) -> None:
    """Remove what the days of meals come to: what is left of them is counted anew, since they are marked.

    No receipt tells of it: the sums of a day are there or not as it happens.
    """
    _forget_study_days(session, Meal, Meal.id.in_(meals))
    days = sa.select(Meal.participant_id, Meal.local_date).where(Meal.id.in_(meals))
    _delete_in_order(session, (DaySum, sa.tuple_(DaySum.participant_id, DaySum.local_date).in_(days)))


def _forget_study_days(session: Session, table: type[DaySum | DayMark | Meal], which: sa.ColumnElement[bool]) -> None:
    """Remove what the study's days of such rows come to over all people, and mark them: others count in them too."""
    days = session.execute(sa.select(table.study_id, table.local_date).where(which).distinct())
    study_day_sums.forget_days(session, [(row[0], row[1]) for row in days])


def end_enrolments(session: Session, participant_id: uuid.UUID) -> None:
    """Remove a participant's enrolment codes, used or not: no further phone comes in."""
    session.execute(sa.delete(Enrolment).where(Enrolment.participant_id == participant_id))


def end_tokens(session: Session, participant_id: uuid.UUID) -> list[str]:
    """Remove the tokens of a participant's devices; returns their SHA-256."""
    devices = sa.select(Device.id).where(Device.participant_id == participant_id)
    return list(
        session.scalars(
            sa.delete(AccessToken).where(AccessToken.device_id.in_(devices)).returning(AccessToken.token_sha256)
        )
    )


def delete_person_marks(session: Session, participant_id: uuid.UUID, meals: Ids) -> dict[str, int]:
    """Of a participant who stays as a number: what leads to phones, photographs or people who were told of them."""
    devices = sa.select(Device.id).where(Device.participant_id == participant_id)
    return _delete_in_order(
        session,
        (
            WebhookDelivery,
            sa.or_(WebhookDelivery.participant_id == participant_id, WebhookDelivery.meal_id.in_(meals)),
        ),
        (CameraCalibration, CameraCalibration.device_id.in_(devices)),
        (MealImage, MealImage.meal_id.in_(meals)),
    )


def devices_of(session: Session, participant_id: uuid.UUID) -> list[Device]:
    """A participant's phones in the order of their enrolment."""
    query = sa.select(Device).where(Device.participant_id == participant_id).order_by(Device.enrolled_at, Device.id)
    return list(session.scalars(query))


def blob_keys_of(session: Session, meals: Ids) -> set[str]:
    """All blobs that rows of these meals name."""
    runs = sa.select(Run.id).where(Run.meal_id.in_(meals))
    queries = (
        sa.select(MealImage.blob_key).where(MealImage.meal_id.in_(meals)),
        sa.select(RunArtefact.blob_key).where(RunArtefact.run_id.in_(runs)),
        sa.select(Run.result_key).where(Run.meal_id.in_(meals)),
    )
    return {key for query in queries for key in session.scalars(query)}


def live_jobs_of(session: Session, meals: Ids) -> list[Job]:
    """Jobs of these meals that are still to be done, locked."""
    query = sa.select(Job).where(Job.meal_id.in_(meals), Job.state.in_(LIVE_STATES)).order_by(Job.id)
    return list(session.scalars(query.with_for_update().execution_options(populate_existing=True)))


def delete_artefacts(session: Session, meals: Ids) -> list[str]:
    """Remove the rows of derived pictures and points; returns the keys of their blobs."""
    runs = sa.select(Run.id).where(Run.meal_id.in_(meals))
    return list(
        session.scalars(sa.delete(RunArtefact).where(RunArtefact.run_id.in_(runs)).returning(RunArtefact.blob_key))
    )


def mark_images_erased(session: Session, meals: Ids, now: datetime) -> list[str]:
    """Note that the photographs go; returns the keys of their blobs."""
    return list(
        session.scalars(
            sa.update(MealImage)
            .where(MealImage.meal_id.in_(meals), MealImage.erased_at.is_(None))
            .values(erased_at=now)
            .returning(MealImage.blob_key)
        )
    )


def touch_meals(session: Session, meals: Ids) -> None:
    """Count a change of each meal, so that those who hold its ETag ask again."""
    session.execute(
        sa.update(Meal)
        .where(Meal.id.in_(meals))
        .values(version=Meal.version + 1)
        .execution_options(synchronize_session=False)
    )


def touch_records_and_days(session: Session, participant_id: uuid.UUID, change_seq: int) -> None:
    """Let those who pull changes hear that a participant's records and days stand under another code now."""
    for table in (EffectiveRecord, DiaryDay):
        session.execute(
            sa.update(table)
            .where(table.participant_id == participant_id)
            .values(change_seq=change_seq)
            .execution_options(synchronize_session=False)
        )


def day_ids(session: Session, participant_id: uuid.UUID) -> list[uuid.UUID]:
    """The ids of a participant's days."""
    return list(session.scalars(sa.select(DiaryDay.id).where(DiaryDay.participant_id == participant_id)))


def events_of(session: Session, meals: Ids) -> Iterator[MealEvent]:
    """The events of these meals, streamed."""
    query = sa.select(MealEvent).where(MealEvent.meal_id.in_(meals)).order_by(MealEvent.meal_id, MealEvent.sequence)
    yield from session.scalars(query)


def day_events_of(session: Session, participant_id: uuid.UUID) -> list[DayEvent]:
    """What was said of a participant's days."""
    query = sa.select(DayEvent).where(DayEvent.participant_id == participant_id)
    return list(session.scalars(query.order_by(DayEvent.local_date, DayEvent.created_at, DayEvent.id)))


def studies_with_retention(session: Session) -> list[Study]:
    """Studies whose photographs do not stay."""
    return list(session.scalars(sa.select(Study).where(Study.retention_days.is_not(None)).order_by(Study.id)))


def meals_with_old_pictures(session: Session, study_id: uuid.UUID, before: datetime, limit: int) -> list[uuid.UUID]:
    """Meals received before that time that still have photographs or derived pictures, locked."""
    has_image = sa.exists().where(MealImage.meal_id == Meal.id, MealImage.erased_at.is_(None))
    has_artefact = sa.exists().where(Run.meal_id == Meal.id, RunArtefact.run_id == Run.id)
    query = (
        sa.select(Meal.id)
        .where(Meal.study_id == study_id, Meal.received_at < before, sa.or_(has_image, has_artefact))
        .order_by(Meal.id)
        .limit(limit)
        .with_for_update()
    )
    return list(session.scalars(query))


def ids_in(meal_ids: Collection[uuid.UUID]) -> Ids:
    """These meals, as a query."""
    return sa.select(Meal.id).where(Meal.id.in_(meal_ids))


def count_erased_participants(session: Session, study_id: uuid.UUID) -> int:
    """How many persons of a study were erased: each has one receipt."""
    query = sa.select(sa.func.count()).where(
        ErasureReceipt.study_id == study_id, ErasureReceipt.what == "participant", ErasureReceipt.policy == "erase"
    )
    return session.scalars(query).one()


def add_tombstones(
    session: Session,
    kind: str,
    digests: Collection[str],
    now: datetime,
    *,
    study_id: uuid.UUID | None,
    change_seq: int | None = None,
) -> None:
    """Note what is erased; what was noted before stays as it is."""
    known = tombstones_among(session, kind, digests)
    session.add_all(
        Tombstone(kind=kind, digest=digest, study_id=study_id, change_seq=change_seq, erased_at=now)
        for digest in sorted(set(digests) - known)
    )
    session.flush()


def tombstones_among(session: Session, kind: str, digests: Collection[str]) -> set[str]:
    """Those of the digests that have a tombstone of this kind."""
    found: set[str] = set()
    wanted = sorted(digests)
    for start in range(0, len(wanted), IN_A_STATEMENT):
        part = wanted[start : start + IN_A_STATEMENT]
        query = sa.select(Tombstone.digest).where(Tombstone.kind == kind, Tombstone.digest.in_(part))
        found.update(session.scalars(query))
    return found


def tombstone_digests(session: Session, kind: str) -> Iterator[str]:
    """The digests of all tombstones of this kind, streamed."""
    yield from session.scalars(
        sa.select(Tombstone.digest).where(Tombstone.kind == kind).execution_options(yield_per=1000)
    )


def participant_ids(session: Session) -> Iterator[uuid.UUID]:
    """All participants, streamed."""
    yield from session.scalars(sa.select(Participant.id).execution_options(yield_per=1000))


def meal_ids(session: Session) -> Iterator[uuid.UUID]:
    """All meals, streamed."""
    yield from session.scalars(sa.select(Meal.id).execution_options(yield_per=1000))


def want_deleted(session: Session, keys: Collection[str], receipt_id: uuid.UUID | None, now: datetime) -> None:
    """Note blobs that are to go; a key that ends with a slash means all below it."""
    wanted = set(keys)
    ordered = sorted(wanted)
    for start in range(0, len(ordered), IN_A_STATEMENT):
        part = ordered[start : start + IN_A_STATEMENT]
        wanted -= set(session.scalars(sa.select(BlobDeletion.blob_key).where(BlobDeletion.blob_key.in_(part))))
    session.add_all(BlobDeletion(blob_key=key, receipt_id=receipt_id, requested_at=now) for key in sorted(wanted))
    session.flush()


def wanted_deletions(session: Session, limit: int) -> list[str]:
    """Blobs that are to go, those that wait longest first."""
    query = sa.select(BlobDeletion.blob_key).order_by(BlobDeletion.requested_at, BlobDeletion.blob_key).limit(limit)
    return list(session.scalars(query))


def forget_deletions(session: Session, keys: Collection[str]) -> None:
    """These blobs are gone."""
    session.execute(sa.delete(BlobDeletion).where(BlobDeletion.blob_key.in_(keys)))


def is_named(session: Session, key: str) -> bool:
    """Whether a row needs the blob, or the meal of a key that means all below it is there."""
    if key.endswith("/"):
        return meals_there(session, [key]) != set()
    images = sa.exists().where(MealImage.blob_key == key, MealImage.erased_at.is_(None))
    artefacts = sa.exists().where(RunArtefact.blob_key == key)
    results = sa.exists().where(Run.result_key == key)
    exported = sa.exists().where(Export.blob_key == key)
    released = sa.exists().where(ReleaseFile.blob_key == key)
    return bool(session.scalar(sa.select(sa.or_(images, artefacts, results, exported, released))))


def of_known_studies(session: Session, keys: Collection[str]) -> set[str]:
    """Those of the keys (`study/...`, and `made/exports/study/...` of files) whose study is there."""
    of_keys = {key: _study_of(key) for key in keys}
    wanted = {study_id for study_id in of_keys.values() if study_id is not None}
    there = set(session.scalars(sa.select(Study.id).where(Study.id.in_(wanted))))
    return {key for key, study_id in of_keys.items() if study_id in there}


def needed_keys(session: Session, keys: Collection[str]) -> set[str]:
    """Those of the keys that a row names, or that a job under way may come to name.

    At most IN_A_STATEMENT keys. A job seals its answer and its pictures before it writes them down, perhaps days later
    if its worker dies in between.
    """
    meal_of = {key: _meal_of(key) for key in keys}
    meals = {meal_id for meal_id in meal_of.values() if meal_id is not None}
    named: sa.CompoundSelect[Any] = sa.union_all(
        sa.select(MealImage.blob_key).where(MealImage.meal_id.in_(meals), MealImage.erased_at.is_(None)),
        sa.select(RunArtefact.blob_key).join(Run, Run.id == RunArtefact.run_id).where(Run.meal_id.in_(meals)),
        sa.select(Run.result_key).where(Run.meal_id.in_(meals)),
        sa.select(Export.blob_key).where(Export.blob_key.in_(keys)),
        sa.select(ReleaseFile.blob_key).where(ReleaseFile.blob_key.in_(keys)),
    )
    # first: a job that ends in between has its run by the time of the second query
    at_work = set(session.scalars(sa.select(Job.meal_id).where(Job.meal_id.in_(meals), Job.state.in_(LIVE_STATES))))
    needed = set(session.scalars(named)) & set(keys)
    return needed | {key for key, meal_id in meal_of.items() if meal_id in at_work}


def meals_there(session: Session, keys: Sequence[str]) -> set[str]:
    """Those of the keys (`study/meal/...`) whose meal is there."""
    of_keys = {key: _meal_of(key) for key in keys}
    wanted = sorted({meal_id for meal_id in of_keys.values() if meal_id is not None})
    there: set[uuid.UUID] = set()
    for start in range(0, len(wanted), IN_A_STATEMENT):
        part = wanted[start : start + IN_A_STATEMENT]
        there.update(session.scalars(sa.select(Meal.id).where(Meal.id.in_(part))))
    return {key for key, meal_id in of_keys.items() if meal_id in there}


def stream_meals_of(session: Session, participant_id: uuid.UUID) -> Iterator[Meal]:
    """A participant's meals in the order of eating, a few at a time in memory."""
    query = sa.select(Meal.id).where(Meal.participant_id == participant_id).order_by(Meal.captured_at, Meal.id)
    for meal_id in list(session.scalars(query)):  # ids only: a stream of rows does not survive its session's emptying
        yield session.get_one(Meal, meal_id)
        session.expunge_all()


def images_of_participant(session: Session, participant_id: uuid.UUID) -> Iterator[tuple[MealImage, uuid.UUID]]:
    """(photograph, its meal's id on the phone) of all that are or were there, streamed."""
    query = (
        sa.select(MealImage, Meal.client_id)
        .join(Meal, Meal.id == MealImage.meal_id)
        .where(Meal.participant_id == participant_id)
        .order_by(Meal.captured_at, Meal.id, MealImage.slot)
    )
    for row in session.execute(query.execution_options(yield_per=100)):
        yield row[0], row[1]


def rows_of_participant(session: Session, participant_id: uuid.UUID) -> Iterator[tuple[str, list[Any]]]:
    """(what, rows) of all that hangs on a participant beside meals, tokens left out."""
    devices = sa.select(Device.id).where(Device.participant_id == participant_id)
    queries: tuple[tuple[str, sa.Select[Any]], ...] = (
        ("devices", sa.select(Device).where(Device.participant_id == participant_id)),
        ("enrolments", sa.select(Enrolment).where(Enrolment.participant_id == participant_id)),
        ("camera_calibrations", sa.select(CameraCalibration).where(CameraCalibration.device_id.in_(devices))),
        ("days", sa.select(DiaryDay).where(DiaryDay.participant_id == participant_id).order_by(DiaryDay.local_date)),
        ("day_events", sa.select(DayEvent).where(DayEvent.participant_id == participant_id)),
        ("told_to_others", sa.select(WebhookDelivery).where(WebhookDelivery.participant_id == participant_id)),
    )
    for name, query in queries:
        yield name, list(session.scalars(query))


def rows_of_meal(session: Session, meal_id: uuid.UUID) -> Iterator[tuple[str, list[Any]]]:
    """(what, rows) of all that hangs on a meal, jobs left out."""
    items = sa.select(Item.id).where(Item.meal_id == meal_id)
    runs = sa.select(Run.id).where(Run.meal_id == meal_id)
    queries: tuple[tuple[str, sa.Select[Any]], ...] = (
        ("photographs", sa.select(MealImage).where(MealImage.meal_id == meal_id)),
        ("runs", sa.select(Run).where(Run.meal_id == meal_id).order_by(Run.created_at)),
        ("derived_pictures", sa.select(RunArtefact).where(RunArtefact.run_id.in_(runs))),
        ("items", sa.select(Item).where(Item.meal_id == meal_id).order_by(Item.position)),
        ("looks", sa.select(ItemIdentification).where(ItemIdentification.item_id.in_(items))),
        ("candidates", sa.select(ItemCandidate).where(ItemCandidate.item_id.in_(items))),
        ("taken_for", sa.select(ItemFood).where(ItemFood.item_id.in_(items)).order_by(ItemFood.version)),
        ("measured_again", sa.select(ItemMeasure).where(ItemMeasure.item_id.in_(items))),
        ("leftovers", sa.select(Leftover).where(Leftover.after_item_id.in_(items))),
        ("known_to_the_index", sa.select(IndexEntry).where(IndexEntry.item_id.in_(items))),
        ("records", sa.select(EffectiveRecord).where(EffectiveRecord.meal_id == meal_id)),
        ("events", sa.select(MealEvent).where(MealEvent.meal_id == meal_id).order_by(MealEvent.sequence)),
        ("told_to_others", sa.select(WebhookDelivery).where(WebhookDelivery.meal_id == meal_id)),
    )
    for name, query in queries:
        yield name, list(session.scalars(query))


def page_of_audit(session: Session, chosen: AuditFilter, *, after: int | None, limit: int) -> list[AuditEvent]:
    """At most `limit` events in their order, those behind `after`."""
    query = sa.select(AuditEvent).order_by(AuditEvent.id).limit(limit)
    if chosen.study_id is not None:
        query = query.where(AuditEvent.study_id == chosen.study_id)
    if chosen.action is not None:
        query = query.where(AuditEvent.action == chosen.action)
    if chosen.since is not None:
        query = query.where(AuditEvent.at >= chosen.since)
    if chosen.until is not None:
        query = query.where(AuditEvent.at < chosen.until)
    if after is not None:
        query = query.where(AuditEvent.id > after)
    return list(session.scalars(query))


def study_codes(session: Session) -> dict[uuid.UUID, str]:
    """Study -> its code."""
    return {row.id: row.code for row in session.execute(sa.select(Study.id, Study.code))}


def _delete_in_order(session: Session, *steps: tuple[type[Base], sa.ColumnElement[bool]]) -> dict[str, int]:
    counts = {}
    session.flush()
    for model, condition in steps:
        done: Any = session.execute(sa.delete(model).where(condition).execution_options(synchronize_session=False))
        counts[model.__tablename__] = done.rowcount
    session.expire_all()
    return counts


def _study_of(key: str) -> uuid.UUID | None:
    parts = key.split("/")
    place = 2 if parts[0] == MADE_FILES else 0
    return _uuid_or_none(parts[place]) if len(parts) > place else None


def _meal_of(key: str) -> uuid.UUID | None:
    parts = key.split("/")
    return _uuid_or_none(parts[1]) if len(parts) > 2 else None


def _uuid_or_none(text: str) -> uuid.UUID | None:
    try:
        return uuid.UUID(text)
    except ValueError:
        return None
