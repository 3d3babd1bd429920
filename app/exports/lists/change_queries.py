"""SQL of a study's changes: changed records and days, and erasures, in the order of its change counter."""

import uuid
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.record_models import EffectiveRecord
from app.people.models import Participant
from app.people.privacy_models import Tombstone
from app.records.queries import RecordRow, rows_of_records

KINDS = ("record", "day", "erased")  # their order within one change


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a row in the order of changes. key: item id, day's id, or digest."""

    change_seq: int
    kind: str
    key: str


@dataclass(frozen=True, slots=True)
class ChangedDay:
    """A day that changed, and its participant's code."""

    day: DiaryDay
    participant_code: str


@dataclass(frozen=True, slots=True)
class Change:
    """A changed or erased row, and its place."""

    place: Place
    row: RecordRow | ChangedDay | Tombstone


def page_of_changes(
    session: Session, study_id: uuid.UUID, after: Place, limit: int
) -> list[Change]:
    """Return at most `limit` changes after a place. A row that changes again moves to its new place."""
    changes = [
        *_records(session, study_id, after, limit),
        *_days(session, study_id, after, limit),
        *_erased(session, study_id, after, limit),
    ]
    # the sort is stable, and each kind is already in the order of its keys
    changes.sort(key=lambda change: (change.place.change_seq, KINDS.index(change.place.kind)))
    return changes[:limit]


def _records(session: Session, study_id: uuid.UUID, after: Place, limit: int) -> list[Change]:
    record = EffectiveRecord
    key = uuid.UUID(after.key) if after.kind == "record" else None
    where = _after(after, "record", record.change_seq, record.item_id, key)
    order = (record.change_seq, record.item_id)
    rows = rows_of_records(session, (record.study_id == study_id, where), order, limit)
    return [
        Change(Place(row.record.change_seq, "record", row.record.item_id.hex), row) for row in rows
    ]


def _days(session: Session, study_id: uuid.UUID, after: Place, limit: int) -> list[Change]:
    key = uuid.UUID(after.key) if after.kind == "day" else None
    query = (
        sa.select(DiaryDay, Participant.code)
        .join(Participant, Participant.id == DiaryDay.participant_id)
        .where(
            DiaryDay.study_id == study_id,
            _after(after, "day", DiaryDay.change_seq, DiaryDay.id, key),
        )
        .order_by(DiaryDay.change_seq, DiaryDay.id)
        .limit(limit)
    )
    return [
        Change(Place(day.change_seq, "day", day.id.hex), ChangedDay(day, code))
        for day, code in session.execute(query)
    ]


def _erased(session: Session, study_id: uuid.UUID, after: Place, limit: int) -> list[Change]:
    key = after.key if after.kind == "erased" else None
    query = (
        sa.select(Tombstone)
        .where(
            Tombstone.kind.in_(("record", "day")),
            Tombstone.study_id == study_id,
            _after(after, "erased", Tombstone.change_seq, Tombstone.digest, key),
        )
        .order_by(Tombstone.change_seq, Tombstone.digest)
        .limit(limit)
    )
    return [
        Change(Place(row.change_seq or 0, "erased", row.digest), row)
        for row in session.scalars(query)
    ]


def _after(
    after: Place, kind: str, change_seq: AnyColumn, column: AnyColumn, key: uuid.UUID | str | None
) -> sa.ColumnElement[bool]:
    """Rows of a kind after a place: those of later changes, and the later ones of the same change."""
    if KINDS.index(kind) > KINDS.index(after.kind):
        return sa.and_(change_seq >= after.change_seq)
    if key is None:
        return sa.and_(change_seq > after.change_seq)
    change = sa.bindparam(None, after.change_seq, type_=sa.BigInteger())
    return sa.tuple_(change_seq, column) > sa.tuple_(
        change, sa.bindparam(None, key, type_=column.type)
    )
