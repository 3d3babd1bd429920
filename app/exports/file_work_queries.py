"""SQL of file work (exports and releases): lists of a study, claims, heartbeats.

A claim is alive while its heartbeats continue, on the database's clock (SQLite: this machine's, as there is only one).
A process whose work was taken over finds another claim in the row, or none, and writes nothing: every write here
requires the claim.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TypeVar

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.base import UtcDateTime
from app.exports.models import UNDER_WAY, Export
from app.exports.release_models import Release
from app.people.models import Staff

LEASE_SECONDS = 60.0  # longer than a writer may wait for the lock on SQLite

Work = Export | Release
OneWork = TypeVar("OneWork", bound=Export | Release)
WorkKey = tuple[datetime, uuid.UUID]  # requested_at, id
KINDS: tuple[type[Work], ...] = (Release, Export)  # by priority
ACTIVE = (*UNDER_WAY, "changing")


@dataclass(frozen=True, slots=True)
class Progress:
    """Rows and bytes written so far."""

    rows: int
    bytes: int


def page_of_works(
    session: Session,
    model: type[OneWork],
    study_id: uuid.UUID,
    *,
    after: WorkKey | None,
    limit: int,
) -> list[tuple[OneWork, str]]:
    """Return at most `limit` (work, name of the person who requested it) of a study after `after`, newest first."""
    query = (
        _requested(model, study_id)
        .order_by(model.requested_at.desc(), model.id.desc())
        .limit(limit)
    )
    if after is not None:
        columns = (model.requested_at, model.id)
        key = (sa.literal(value, column.type) for value, column in zip(after, columns, strict=True))
        query = query.where(sa.tuple_(model.requested_at, model.id) < sa.tuple_(*key))
    return [(work, name) for work, name in session.execute(query)]


def find_work(
    session: Session,
    model: type[OneWork],
    study_id: uuid.UUID,
    condition: sa.ColumnElement[bool],
    *,
    lock: bool,
) -> tuple[OneWork, str] | None:
    """Return (work, name of the person who requested it) of a study. lock: refresh the row and lock it."""
    query = _requested(model, study_id).where(condition)
    if lock:
        query = query.with_for_update(of=model).execution_options(populate_existing=True)
    row = session.execute(query).one_or_none()
    return (row[0], row[1]) if row is not None else None


def has_work(session: Session, lease_seconds: float = LEASE_SECONDS) -> bool:
    """Whether some work can be started: it has no claim, or its claim is dead."""
    return any(
        session.scalar(
            sa.select(sa.literal(1)).where(
                sa.exists().where(_is_free(session, model, lease_seconds))
            )
        )
        for model in KINDS
    )


def claim_next(
    session: Session, claim: uuid.UUID, lease_seconds: float = LEASE_SECONDS
) -> Work | None:
    """Claim the work that has waited longest; None if nothing waits."""
    for model in KINDS:
        for work in _works(
            session, model, _is_free(session, model, lease_seconds), limit=1, skip_locked=True
        ):
            begin_again(work, counts=True)
            work.claim = claim
            work.attempts += 1
            work.started_at = work.started_at or datetime.now(UTC)
            if work.state == "queued":
                work.state = "running"
            session.flush()
            beat(session, work, claim, Progress(0, 0))
            return work
    return None


def beat(session: Session, work: Work, claim: uuid.UUID, progress: Progress) -> bool:
    """Write a heartbeat with the progress. Returns False if the claim is lost."""
    model = type(work)
    updated = session.scalar(
        sa.update(model)
        .where(model.id == work.id, model.claim == claim)
        .values(heartbeat_at=_clock(session), rows_written=progress.rows, bytes=progress.bytes)
        .returning(model.id)
        .execution_options(synchronize_session=False)
    )
    return updated is not None


def save_estimate(session: Session, work: Work, claim: uuid.UUID, rows: int) -> None:
    """Save the estimated number of rows."""
    model = type(work)
    session.execute(
        sa.update(model)
        .where(model.id == work.id, model.claim == claim)
        .values(rows_estimated=rows)
        .execution_options(synchronize_session=False)
    )


def hold(session: Session, work: OneWork, claim: uuid.UUID) -> OneWork | None:
    """Refresh the work and lock it; None if the claim is lost."""
    model = type(work)
    return next(
        iter(_works(session, model, sa.and_(model.id == work.id, model.claim == claim))), None
    )


def put_back(session: Session, claim: uuid.UUID, *, counts: bool) -> int:
    """Release this claim's work, so that others can start it at once. counts: as an attempt. Returns the number."""
    total = 0
    for model in KINDS:
        for work in _works(session, model, model.claim == claim):
            begin_again(work, counts=counts)
            total += 1
    return total


def begin_again(work: Work, *, counts: bool, after_seconds: float = 0.0) -> None:
    """Discard what was made so far; the process that makes it loses the claim with its next heartbeat."""
    if work.state in UNDER_WAY:
        work.state = "queued"
    work.claim = work.heartbeat_at = work.rows_estimated = None
    work.rows_written = work.bytes = 0
    work.begin_after = (
        datetime.now(UTC) + timedelta(seconds=after_seconds) if after_seconds else None
    )
    if not counts and work.attempts:
        work.attempts -= 1


def _requested(model: type[OneWork], study_id: uuid.UUID) -> sa.Select[OneWork, str]:
    return (
        sa.select(model, Staff.name)
        .join(Staff, Staff.id == model.staff_id)
        .where(model.study_id == study_id)
    )


def _works(
    session: Session,
    model: type[OneWork],
    condition: sa.ColumnElement[bool],
    *,
    limit: int | None = None,
    skip_locked: bool = False,
) -> Sequence[OneWork]:
    """Refresh and lock the rows; the one that has waited longest first."""
    query = sa.select(model).where(condition).order_by(model.requested_at, model.id).limit(limit)
    query = query.with_for_update(skip_locked=skip_locked).execution_options(populate_existing=True)
    return session.scalars(query).all()


def _is_free(session: Session, model: type[Work], lease_seconds: float) -> sa.ColumnElement[bool]:
    """A future heartbeat does not count: the database's clock went back, and a live process beats again soon."""
    is_unclaimed = sa.or_(
        model.claim.is_(None),
        model.heartbeat_at < _clock(session, -lease_seconds),
        model.heartbeat_at > _clock(session, lease_seconds),
    )
    is_due = sa.or_(model.begin_after.is_(None), model.begin_after <= _clock(session))
    return sa.and_(model.state.in_(ACTIVE), is_unclaimed, is_due)


def _clock(session: Session, seconds: float = 0.0) -> sa.ColumnElement[datetime]:
    """Return the database's time plus `seconds`."""
    shift = timedelta(seconds=seconds)
    if session.get_bind().dialect.name == "sqlite":
        return sa.literal(datetime.now(UTC) + shift, UtcDateTime())
    return sa.func.clock_timestamp(type_=sa.DateTime(timezone=True)) + shift
