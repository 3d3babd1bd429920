"""SQL of the kept sums of days: written anew where a day is marked, and compared with what days come to."""

import uuid
from collections.abc import Collection, Mapping, Sequence
from datetime import date
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.diary.day_definition import COLUMNS, DayKeys, counted_days
from app.diary.models import DayMark, DaySum, StudyDayMark
from app.meals.day_models import DiaryDay
from app.meals.models import Meal
from app.people.models import Participant

WRITER_LOCK = 4_738_112  # of who writes sums, on PostgreSQL: any number, ours alone
OF_ONE_TURN = 200  # marks: SQLite's other writers wait for no more than their days

DayOf = tuple[uuid.UUID, date]  # participant (or study), local day
KeyColumns = tuple[InstrumentedAttribute[uuid.UUID], InstrumentedAttribute[date]]
Columns = Mapping[str, object]
Pair = tuple[DayOf, Columns | None, Columns | None]  # what is kept of a day, and what it comes to


class Mark(NamedTuple):
    """A day that has changed."""

    id: int
    participant_id: uuid.UUID
    local_date: date


def take_turn(session: Session) -> bool:
    """Whether nobody else writes sums until this transaction ends.

    Two at once could write the same day, the one who counted first last. SQLite has one writer anyway.
    """
    if session.get_bind().dialect.name == "sqlite":
        return True
    return bool(session.scalar(sa.select(sa.func.pg_try_advisory_xact_lock(WRITER_LOCK))))


def has_marks(session: Session) -> bool:
    """Whether the sums of any day may be of before."""
    return bool(session.scalar(sa.select(sa.exists().where(DayMark.id.is_not(None)))))


def newest_marks(session: Session, limit: int) -> list[Mark]:
    """Some marks, those of the newest changes first: after an upgrade every day of years has one."""
    query = sa.select(DayMark.id, DayMark.participant_id, DayMark.local_date).order_by(DayMark.id.desc()).limit(limit)
    return [Mark(*row) for row in session.execute(query)]


def people_among(session: Session, ids: Collection[uuid.UUID]) -> tuple[set[uuid.UUID], set[uuid.UUID]]:
    """(those who are there, those of them who stay until this transaction ends): others are just being erased."""
    query = sa.select(Participant.id).where(Participant.id.in_(ids))
    there = set(session.scalars(query))
    locked = query.order_by(Participant.id).with_for_update(read=True, key_share=True, skip_locked=True)
    return there, set(session.scalars(locked))


def write_sums(session: Session, marks: Sequence[Mark]) -> None:
    """Count the days of these marks and keep the sums; the marks were read by an earlier statement."""
    seen = [mark.id for mark in marks]
    page = sa.select(DayMark.participant_id, DayMark.local_date).where(DayMark.id.in_(seen)).distinct().cte("page")
    delete_sums(session, DayMark.id.in_(seen))
    session.execute(sa.insert(DaySum).from_select(list(COLUMNS), counted_days(page)))
    forget_marks(session, seen)


def delete_sums(session: Session, of_marks: sa.ColumnElement[bool]) -> None:
    """Remove the sums of days of which there is such a mark."""
    days = sa.select(DayMark.participant_id, DayMark.local_date).where(of_marks)
    session.execute(
        sa.delete(DaySum)
        .where(sa.tuple_(DaySum.participant_id, DaySum.local_date).in_(days))
        .execution_options(synchronize_session=False)
    )


def forget_marks(session: Session, ids: Collection[int]) -> None:
    """What they say is in the sums: their studies' days are marked in turn."""
    days = sa.select(DayMark.study_id, DayMark.local_date).where(DayMark.id.in_(ids)).distinct()
    session.execute(sa.insert(StudyDayMark).from_select(["study_id", "local_date"], days))
    session.execute(sa.delete(DayMark).where(DayMark.id.in_(ids)).execution_options(synchronize_session=False))


def mark_days(session: Session, days: Collection[DayOf]) -> None:
    """Have these days' sums written anew; those of participants who are not there any more are left alone."""
    people = dict(
        session.execute(
            sa.select(Participant.id, Participant.study_id).where(Participant.id.in_({day[0] for day in days}))
        ).all()
    )
    session.add_all(
        DayMark(participant_id=who, local_date=day, study_id=people[who]) for who, day in days if who in people
    )
    session.flush()


def days_after(session: Session, after: DayOf | None, limit: int) -> list[DayOf]:
    """The first days behind a day, by (participant, day), that have a meal, a diary entry or a sum."""
    return keys_after(
        session, [(table.participant_id, table.local_date) for table in (Meal, DiaryDay, DaySum)], after, limit
    )


def keys_after(session: Session, keys: Sequence[KeyColumns], after: DayOf | None, limit: int) -> list[DayOf]:
    """The first (owner, local day) behind one that some tables have. keys: these two columns of each table."""
    parts = []
    for columns in keys:
        query = sa.select(*columns).distinct().order_by(*columns).limit(limit)
        if after is not None:
            query = query.where(sa.tuple_(*columns) > _literal(after))
        parts.append(sa.select(*query.subquery().c))
    every = sa.union(*parts).subquery()
    rows = session.execute(sa.select(*every.c).order_by(*every.c).limit(limit))
    return [(row[0], row[1]) for row in rows]


def kept_and_counted(session: Session, days: Sequence[DayOf]) -> list[Pair]:
    """Of a run of days (days_after) that are not marked: what is kept of each, and what it comes to."""
    kept_rows = sa.select(*(DaySum.__table__.c[name] for name in COLUMNS)).where(*_from_to(DaySum, days))
    kept = {_key(row): dict(row) for row in session.execute(kept_rows).mappings()}
    marks = sa.select(DayMark.participant_id, DayMark.local_date).where(*_from_to(DayMark, days))
    marked = {_key(row) for row in session.execute(marks).mappings()}
    counted = counted_sums(session, days)
    return [(day, kept.get(day), counted.get(day)) for day in days if day not in marked]


def counted_sums(session: Session, days: Sequence[DayOf]) -> dict[DayOf, Columns]:
    """What a run of days comes to."""
    keys = [
        sa.select(table.participant_id, table.local_date).where(*_from_to(table, days)) for table in (Meal, DiaryDay)
    ]
    return {_key(row): dict(row) for row in session.execute(counted_days(sa.union(*keys).cte("page"))).mappings()}


def _key(row: sa.RowMapping) -> DayOf:
    return row["participant_id"], row["local_date"]


def _from_to(table: DayKeys, days: Sequence[DayOf]) -> tuple[sa.ColumnElement[bool], sa.ColumnElement[bool]]:
    key = sa.tuple_(table.participant_id, table.local_date)
    return key >= _literal(days[0]), key <= _literal(days[-1])


def _literal(day: DayOf) -> sa.Tuple:
    return sa.tuple_(sa.literal(day[0], sa.Uuid()), sa.literal(day[1], sa.Date()))
