"""SQL of the sums of participants' days: read, written again where a day is marked, and compared with a recount.

`sums_of_days` is where every figure of days comes from: the stored DaySum, or a recount (day_definition.py) of a day
that has changed since the sum was written (DayMark), so that figures are right at the moment of the query.
"""

import uuid
from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import date
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.diary.day_definition import COLUMNS, DayKeys, counted_days, same_day, within
from app.diary.models import DayMark, DaySum, StudyDayMark
from app.meals.day_models import DiaryDay
from app.meals.models import Meal
from app.people.models import Participant

WRITER_LOCK = 4_738_112  # advisory lock of the process that writes sums, on PostgreSQL: an arbitrary, unique number
MARKS_PER_TRANSACTION = 200  # SQLite's other writers wait while the days of so many marks are counted

OwnerDay = tuple[uuid.UUID, date]  # participant (or study), local day
KeyColumns = tuple[InstrumentedAttribute[uuid.UUID], InstrumentedAttribute[date]]
Columns = Mapping[str, object]
StoredAndCounted = tuple[OwnerDay, Columns | None, Columns | None]
Conditions = Sequence[sa.ColumnElement[bool]]
DayTable = type[DaySum | DayMark | Meal | DiaryDay]
DaySelection = Callable[[DayTable], Conditions]  # conditions on a table's participant_id, local_date and study_id


class Mark(NamedTuple):
    """A day that has changed."""

    id: int
    participant_id: uuid.UUID
    local_date: date


def select_study_days(study_id: uuid.UUID, first_day: date | None, last_day: date | None) -> DaySelection:
    """Select the days of a study in a range, both ends included."""
    return lambda table: [table.study_id == study_id, *within(table.local_date, first_day, last_day)]


def sums_of_days(session: Session, selection: DaySelection) -> sa.Subquery:
    """Return a subquery of the selected days' sums, COLUMNS of DaySum; marked days are counted again."""
    stored = sa.select(*(DaySum.__table__.c[name] for name in COLUMNS)).where(*selection(DaySum))
    if not session.scalar(sa.select(sa.exists().where(*selection(DayMark)))):
        return stored.subquery("day")
    keys = sa.select(DayMark.participant_id, DayMark.local_date).where(*selection(DayMark)).distinct()
    return sa.union_all(stored.where(~is_marked(DaySum)), counted_days(keys.cte("marked"))).subquery("day")


def is_marked(day: DayKeys) -> sa.ColumnElement[bool]:
    """Whether a day has changed since its sums were written."""
    return sa.exists().where(same_day(DayMark, day))


def try_lock_writer(session: Session) -> bool:
    """Whether this transaction is the only one that writes sums.

    Two writers could count the same day, and the earlier count could be written last. SQLite has one writer anyway.
    """
    if session.get_bind().dialect.name == "sqlite":
        return True
    return bool(session.scalar(sa.select(sa.func.pg_try_advisory_xact_lock(WRITER_LOCK))))


def has_marks(session: Session) -> bool:
    """Whether any day's sums may be outdated."""
    return bool(session.scalar(sa.select(sa.exists().where(DayMark.id.is_not(None)))))


def newest_marks(session: Session, limit: int) -> list[Mark]:
    """Return at most `limit` marks, the newest first: after an upgrade every day of several years is marked."""
    query = sa.select(DayMark.id, DayMark.participant_id, DayMark.local_date).order_by(DayMark.id.desc()).limit(limit)
    return [Mark(*row) for row in session.execute(query)]


def lock_existing_participants(session: Session, ids: Collection[uuid.UUID]) -> tuple[set[uuid.UUID], set[uuid.UUID]]:
    """Return (participants that exist, those of them locked until commit); an erasure holds the others."""
    query = sa.select(Participant.id).where(Participant.id.in_(ids))
    existing = set(session.scalars(query))
    locked = query.order_by(Participant.id).with_for_update(read=True, key_share=True, skip_locked=True)
    return existing, set(session.scalars(locked))


def write_sums(session: Session, marks: Sequence[Mark]) -> None:
    """Count the days of these marks, store the sums and remove the marks, which an earlier statement has read."""
    mark_ids = [mark.id for mark in marks]
    days = sa.select(DayMark.participant_id, DayMark.local_date).where(DayMark.id.in_(mark_ids)).distinct()
    delete_sums(session, days)
    session.execute(sa.insert(DaySum).from_select(list(COLUMNS), counted_days(days.cte("page"))))
    remove_marks(session, mark_ids)


def delete_sums(session: Session, days: sa.Select[uuid.UUID, date]) -> None:
    """Delete the stored sums of days."""
    session.execute(
        sa.delete(DaySum)
        .where(sa.tuple_(DaySum.participant_id, DaySum.local_date).in_(days))
        .execution_options(synchronize_session=False)
    )


def remove_marks(session: Session, ids: Collection[int]) -> None:
    """Remove marks whose days are counted, and mark the days of their studies in turn."""
    days = sa.select(DayMark.study_id, DayMark.local_date).where(DayMark.id.in_(ids)).distinct()
    session.execute(sa.insert(StudyDayMark).from_select(["study_id", "local_date"], days))
    session.execute(sa.delete(DayMark).where(DayMark.id.in_(ids)).execution_options(synchronize_session=False))


def mark_days(session: Session, days: Collection[OwnerDay]) -> None:
    """Mark days, so that their sums are written again; days of participants who are erased are left out."""
    study_of_participant = dict(
        session.execute(
            sa.select(Participant.id, Participant.study_id).where(Participant.id.in_({day[0] for day in days}))
        ).all()
    )
    session.add_all(
        DayMark(participant_id=participant_id, local_date=local_date, study_id=study_of_participant[participant_id])
        for participant_id, local_date in days
        if participant_id in study_of_participant
    )
    session.flush()


def days_after(session: Session, after: OwnerDay | None, limit: int) -> list[OwnerDay]:
    """Return the first days after one, by (participant, day), that have a meal, a diary entry or a sum."""
    return keys_after(
        session, [(table.participant_id, table.local_date) for table in (Meal, DiaryDay, DaySum)], after, limit
    )


def keys_after(session: Session, keys: Sequence[KeyColumns], after: OwnerDay | None, limit: int) -> list[OwnerDay]:
    """Return the first (owner, local day) after one in several tables. keys: these two columns of each table."""
    parts = []
    for columns in keys:
        query = sa.select(*columns).distinct().order_by(*columns).limit(limit)
        if after is not None:
            query = query.where(sa.tuple_(*columns) > _literal(after))
        parts.append(sa.select(*query.subquery().c))
    union = sa.union(*parts).subquery()
    rows = session.execute(sa.select(*union.c).order_by(*union.c).limit(limit))
    return [(row[0], row[1]) for row in rows]


def stored_and_counted(session: Session, days: Sequence[OwnerDay]) -> list[StoredAndCounted]:
    """Return the stored sums and a recount of each unmarked day. days: consecutive ones, from days_after."""
    stored_rows = sa.select(*(DaySum.__table__.c[name] for name in COLUMNS)).where(*_between(DaySum, days))
    stored = {_key(row): dict(row) for row in session.execute(stored_rows).mappings()}
    marks = sa.select(DayMark.participant_id, DayMark.local_date).where(*_between(DayMark, days))
    marked = {_key(row) for row in session.execute(marks).mappings()}
    counted = counted_sums(session, days)
    return [(day, stored.get(day), counted.get(day)) for day in days if day not in marked]


def counted_sums(session: Session, days: Sequence[OwnerDay]) -> dict[OwnerDay, Columns]:
    """Count consecutive days from meals, records and diary entries."""
    keys = [
        sa.select(table.participant_id, table.local_date).where(*_between(table, days)) for table in (Meal, DiaryDay)
    ]
    return {_key(row): dict(row) for row in session.execute(counted_days(sa.union(*keys).cte("page"))).mappings()}


def _key(row: sa.RowMapping) -> OwnerDay:
    return row["participant_id"], row["local_date"]


def _between(table: DayKeys, days: Sequence[OwnerDay]) -> tuple[sa.ColumnElement[bool], sa.ColumnElement[bool]]:
    key = sa.tuple_(table.participant_id, table.local_date)
    return key >= _literal(days[0]), key <= _literal(days[-1])


def _literal(day: OwnerDay) -> sa.Tuple:
    return sa.tuple_(sa.literal(day[0], sa.Uuid()), sa.literal(day[1], sa.Date()))
