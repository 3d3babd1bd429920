"""SQL of files in the making: a study's, whose turn it is, who works on which, and whether they still live.

A claim lives by its heartbeats, on the database's clock (SQLite: one machine, so this machine's). Whoever comes back
after a takeover finds another claim in the row, or none, and writes nothing: each write here asks for the claim.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.base import UtcDateTime
from app.exports.models import UNDER_WAY, Export
from app.exports.release_models import Release
from app.people.models import Staff

LEASE_SECONDS = 60.0  # longer than a writer may wait for its turn on SQLite

Work = Export | Release
OneWork = TypeVar("OneWork", bound=Export | Release)
WorkKey = tuple[datetime, uuid.UUID]  # requested_at, id
KINDS: tuple[type[Work], ...] = (Release, Export)  # in this order where several wait
ACTIVE = (*UNDER_WAY, "changing")


@dataclass(frozen=True, slots=True)
class Sums:
    """How far a file is."""

    rows: int
    bytes: int


def page_of_works(
    session: Session, model: type[OneWork], study_id: uuid.UUID, *, after: WorkKey | None, limit: int
) -> list[tuple[OneWork, str]]:
    """At most `limit` of a study, the newest first, those behind `after`; with the name of who asked for each."""
    query = _asked_for(model, study_id).order_by(model.requested_at.desc(), model.id.desc()).limit(limit)
    if after is not None:
        key = (sa.literal(one, column.type) for one, column in zip(after, (model.requested_at, model.id), strict=True))
        query = query.where(sa.tuple_(model.requested_at, model.id) < sa.tuple_(*key))
    return [(work, name) for work, name in session.execute(query)]


def find_work(
    session: Session, model: type[OneWork], study_id: uuid.UUID, which: sa.ColumnElement[bool], *, lock: bool
) -> tuple[OneWork, str] | None:
    """One of a study, with the name of who asked for it; lock: as it is now, and nobody else changes it."""
    query = _asked_for(model, study_id).where(which)
    if lock:
        query = query.with_for_update(of=model).execution_options(populate_existing=True)
    row = session.execute(query).one_or_none()
    return (row[0], row[1]) if row is not None else None


def has_work(session: Session, lease_seconds: float = LEASE_SECONDS) -> bool:
    """Whether there is something to begin: nobody works on it, or whoever did has died."""
    return any(
        session.scalar(sa.select(sa.literal(1)).where(sa.exists().where(_is_free(session, model, lease_seconds))))
        for model in KINDS
    )


def claim_next(session: Session, claim: uuid.UUID, lease_seconds: float = LEASE_SECONDS) -> Work | None:
    """What waits longest, now ours; None: nothing waits."""
    for model in KINDS:
        for work in _works(session, model, _is_free(session, model, lease_seconds), limit=1, skip_locked=True):
            begin_again(work, counts=True)
            work.claim = claim
            work.attempts += 1
            work.started_at = work.started_at or datetime.now(UTC)
            if work.state == "queued":
                work.state = "running"
            session.flush()
            beat(session, work, claim, Sums(0, 0))
            return work
    return None


def beat(session: Session, work: Work, claim: uuid.UUID, sums: Sums) -> bool:
    """A sign of life, with how far it is. False: it is not ours any more."""
    model = type(work)
    done: Any = session.execute(
        sa.update(model)
        .where(model.id == work.id, model.claim == claim)
        .values(heartbeat_at=_clock(session), rows_written=sums.rows, bytes=sums.bytes)
        .execution_options(synchronize_session=False)
    )
    return bool(done.rowcount)


def estimate(session: Session, work: Work, claim: uuid.UUID, rows: int) -> None:
    """How many rows there will be, about."""
    model = type(work)
    session.execute(
        sa.update(model)
        .where(model.id == work.id, model.claim == claim)
        .values(rows_estimated=rows)
        .execution_options(synchronize_session=False)
    )


def hold(session: Session, work: OneWork, claim: uuid.UUID) -> OneWork | None:
    """The work as it is now, locked; None: it is not ours any more."""
    model = type(work)
    return next(iter(_works(session, model, sa.and_(model.id == work.id, model.claim == claim))), None)


def put_back(session: Session, claim: uuid.UUID, *, counts: bool) -> int:
    """Let others begin what this claim has, at once. counts: as a try. Returns how many."""
    total = 0
    for model in KINDS:
        for work in _works(session, model, model.claim == claim):
            begin_again(work, counts=counts)
            total += 1
    return total


def begin_again(work: Work, *, counts: bool, after_seconds: float = 0.0) -> None:
    """What was made so far does not count; whoever makes it finds the claim gone with the next heartbeat."""
    if work.state in UNDER_WAY:
        work.state = "queued"
    work.claim = work.heartbeat_at = work.rows_estimated = None
    work.rows_written = work.bytes = 0
    work.begin_after = datetime.now(UTC) + timedelta(seconds=after_seconds) if after_seconds else None
    if not counts and work.attempts:
        work.attempts -= 1


def _asked_for(model: type[OneWork], study_id: uuid.UUID) -> sa.Select[OneWork, str]:
    return sa.select(model, Staff.name).join(Staff, Staff.id == model.staff_id).where(model.study_id == study_id)


def _works(
    session: Session,
    model: type[OneWork],
    which: sa.ColumnElement[bool],
    *,
    limit: int | None = None,
    skip_locked: bool = False,
) -> Sequence[OneWork]:
    """As they are now, not as they were read before, and locked; the one that waits longest first."""
    query = sa.select(model).where(which).order_by(model.requested_at, model.id).limit(limit)
    query = query.with_for_update(skip_locked=skip_locked).execution_options(populate_existing=True)
    return session.scalars(query).all()


def _is_free(session: Session, model: type[Work], lease_seconds: float) -> sa.ColumnElement[bool]:
    """A heartbeat of a time to come is no sign of life: the database's clock went back, and who lives beats again."""
    is_left = sa.or_(
        model.claim.is_(None),
        model.heartbeat_at < _clock(session, -lease_seconds),
        model.heartbeat_at > _clock(session, lease_seconds),
    )
    is_due = sa.or_(model.begin_after.is_(None), model.begin_after <= _clock(session))
    return sa.and_(model.state.in_(ACTIVE), is_left, is_due)


def _clock(session: Session, seconds: float = 0.0) -> sa.ColumnElement[Any]:
    """The database's time, so many seconds on."""
    shift = timedelta(seconds=seconds)
    if session.get_bind().dialect.name == "sqlite":
        return sa.literal(datetime.now(UTC) + shift, UtcDateTime())
    return sa.func.clock_timestamp(type_=sa.DateTime(timezone=True)) + shift
