"""SQL of the figures that /metrics and `tada doctor` tell of a deployment: each one is answered from an index.

Nothing here counts what a study gathers in years (estimated meals, records): such a count grows with the data, and a
scrape may not.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.diary.models import DayMark, StudyDayMark
from app.exports.models import UNDER_WAY, Export
from app.exports.release_models import Release, ReleaseChange
from app.meals.job_models import Job
from app.meals.models import Meal
from app.outbox.models import Webhook, WebhookDelivery
from app.people.privacy_models import IS_BACKUP, AuditEvent, BlobDeletion

OPEN_STATUSES = ("receiving", "queued", "processing", "needs_review")  # of meals that somebody is still to move on
COUNTED_AT_MOST = 100_000  # rows of one kind: who has more needs no closer figure


@dataclass(frozen=True, slots=True)
class FilesWaiting:
    """Exports, or releases, that are not made yet. oldest_at: since when the first of them is wanted."""

    states: Mapping[str, int]
    oldest_at: datetime | None


@dataclass(frozen=True, slots=True)
class Figures:
    """What waits, and since when. Times: the database's clock; None where nothing waits."""

    now: datetime
    meals: Mapping[str, int]  # by status, OPEN_STATUSES only
    jobs: Mapping[str, int]  # queued, processing
    oldest_queued_at: datetime | None
    studies_waiting: int
    deliveries_waiting: int
    oldest_delivery_at: datetime | None
    webhooks_disabled: int
    deletions_waiting: int
    oldest_deletion_at: datetime | None
    files: Mapping[str, FilesWaiting]  # export, release
    releases_stuck: int  # that an erasure wants changed, and that could not be; each is tried again
    marked_days: Mapping[str, int]  # participant, study: days whose kept sums are of before; marks have no time


def figures(session: Session) -> Figures:
    """All of them, in one snapshot."""
    now = database_now(session)
    meals = {status: _count(session, Meal.status == status) for status in OPEN_STATUSES}
    jobs = {state: _count(session, Job.state == state) for state in ("queued", "processing")}
    waiting = sa.select(Meal.study_id).where(Meal.status == "queued").limit(COUNTED_AT_MOST).subquery()
    return Figures(
        now=now,
        meals=meals,
        jobs=jobs,
        oldest_queued_at=session.scalar(sa.select(sa.func.min(Job.enqueued_at)).where(Job.state == "queued")),
        studies_waiting=session.scalar(sa.select(sa.func.count(sa.distinct(waiting.c.study_id)))) or 0,
        deliveries_waiting=_count(session, WebhookDelivery.state == "waiting"),
        oldest_delivery_at=_oldest(
            session, sa.select(WebhookDelivery.created_at).where(WebhookDelivery.state == "waiting")
        ),
        webhooks_disabled=_count(session, Webhook.disabled_at.is_not(None)),
        deletions_waiting=_count(session, BlobDeletion.requested_at.is_not(None)),
        oldest_deletion_at=_oldest(session, sa.select(BlobDeletion.requested_at)),
        files={"export": _exports_waiting(session), "release": _releases_waiting(session)},
        releases_stuck=_count(session, Release.state == "changing", Release.failure_code.is_not(None)),
        marked_days={
            "participant": _count(session, DayMark.id.is_not(None)),
            "study": _count(session, StudyDayMark.id.is_not(None)),
        },
    )


def database_now(session: Session) -> datetime:
    """The database's clock: on SQLite this machine's."""
    if session.get_bind().dialect.name == "sqlite":
        return datetime.now(UTC)
    now: datetime = session.execute(sa.select(sa.func.clock_timestamp(type_=sa.DateTime(timezone=True)))).scalar_one()
    return now


def _exports_waiting(session: Session) -> FilesWaiting:
    states = {state: _count(session, Export.state == state) for state in UNDER_WAY}
    return FilesWaiting(states, _oldest(session, sa.select(Export.requested_at).where(Export.state.in_(UNDER_WAY))))


def _releases_waiting(session: Session) -> FilesWaiting:
    """One that changes is wanted since the first erasure that it is without, not since it was frozen."""
    states = {state: _count(session, Release.state == state) for state in (*UNDER_WAY, "changing")}
    wanted = sa.union_all(
        sa.select(Release.requested_at).where(Release.state.in_(UNDER_WAY)), sa.select(ReleaseChange.requested_at)
    ).subquery()
    return FilesWaiting(states, _oldest(session, sa.select(wanted.c.requested_at)))


def _count(session: Session, *conditions: sa.ColumnElement[bool]) -> int:
    rows = sa.select(sa.literal(1)).where(*conditions).limit(COUNTED_AT_MOST).subquery()
    return session.scalar(sa.select(sa.func.count()).select_from(rows)) or 0


def _oldest(session: Session, times: sa.Select[datetime]) -> datetime | None:
    """The first of these times, or of as many as are counted at most."""
    rows = times.limit(COUNTED_AT_MOST).subquery()
    first: datetime | None = session.scalar(sa.select(sa.func.min(rows.c[0])))
    return first


@dataclass(frozen=True, slots=True)
class LastBackup:
    """The last `tada backup` that ended. damaged: blobs that it lacks, for they were damaged or missing.

    piped: it went to another program, of which nobody here knows whether it kept it.
    """

    made_at: datetime
    damaged: int
    piped: bool = False


def last_backup(session: Session) -> LastBackup | None:
    """None: there was none. By an index of its own, however many events came after it."""
    query = sa.select(AuditEvent.at, AuditEvent.details).where(IS_BACKUP).order_by(AuditEvent.id.desc()).limit(1)
    found = session.execute(query).first()
    if found is None:
        return None
    return LastBackup(found.at, int(found.details.get("damaged", 0)), piped=bool(found.details.get("piped", False)))


def first_event_at(session: Session) -> datetime | None:
    """When the audit log begins, and so the deployment; None: nothing has happened yet."""
    first: datetime | None = session.scalar(sa.select(AuditEvent.at).order_by(AuditEvent.id).limit(1))
    return first
