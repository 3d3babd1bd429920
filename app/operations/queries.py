"""SQL of the figures for metrics and of the doctor's checks."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.exports.models import UNDER_WAY, Export
from app.exports.release_models import Release, ReleaseChange
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.outbox.models import Webhook, WebhookDelivery
from app.people.privacy_models import IS_BACKUP, AuditEvent, BlobDeletion

# of meals that are not finished
OPEN_STATUSES = ("receiving", "queued", "processing", "needs_review")
COUNTED_AT_MOST = 100_000  # rows of one kind; counting stops here
PG_SETTINGS = (
    "server_version_num",
    "server_encoding",
    "fsync",
    "synchronous_commit",
    "full_page_writes",
    "max_connections",
    "superuser_reserved_connections",
    "statement_timeout",
    "TimeZone",
)


@dataclass(frozen=True, slots=True)
class FilesWaiting:
    """Exports, or releases, that are pending. oldest_at: when the oldest of them was requested."""

    states: Mapping[str, int]
    oldest_at: datetime | None


@dataclass(frozen=True, slots=True)
class Figures:
    """Numbers of pending things and their ages.

    Times: of the database's clock; None if nothing is pending.
    """

    now: datetime
    meals: Mapping[str, int]  # by status, OPEN_STATUSES only
    jobs: Mapping[str, int]  # queued, processing; without background jobs
    oldest_queued_at: datetime | None
    studies_waiting: int
    deliveries_waiting: int
    oldest_delivery_at: datetime | None
    webhooks_disabled: int
    deletions_waiting: int
    oldest_deletion_at: datetime | None
    files: Mapping[str, FilesWaiting]  # export, release
    releases_stuck: int  # that could not be changed for an erasure; retried


def figures(session: Session) -> Figures:
    """Return all figures, in one snapshot."""
    now = database_now(session)
    meals = {status: _count(session, Meal.status == status) for status in OPEN_STATUSES}
    jobs = {
        state: _count(session, Job.state == state, ~Job.is_background)
        for state in ("queued", "processing")
    }
    waiting = (
        sa.select(Meal.study_id).where(Meal.status == "queued").limit(COUNTED_AT_MOST).subquery()
    )
    return Figures(
        now=now,
        meals=meals,
        jobs=jobs,
        oldest_queued_at=session.scalar(
            sa.select(sa.func.min(Job.enqueued_at)).where(Job.state == "queued", ~Job.is_background)
        ),
        studies_waiting=session.scalar(sa.select(sa.func.count(sa.distinct(waiting.c.study_id))))
        or 0,
        deliveries_waiting=_count(session, WebhookDelivery.state == "waiting"),
        oldest_delivery_at=_oldest(
            session, sa.select(WebhookDelivery.created_at).where(WebhookDelivery.state == "waiting")
        ),
        webhooks_disabled=_count(session, Webhook.disabled_at.is_not(None)),
        deletions_waiting=_count(session, BlobDeletion.requested_at.is_not(None)),
        oldest_deletion_at=_oldest(session, sa.select(BlobDeletion.requested_at)),
        files={"export": _exports_waiting(session), "release": _releases_waiting(session)},
        releases_stuck=_count(
            session, Release.state == "changing", Release.failure_code.is_not(None)
        ),
    )


def database_now(session: Session) -> datetime:
    """Return the database's time; on SQLite this machine's."""
    if session.get_bind().dialect.name == "sqlite":
        return datetime.now(UTC)
    now: datetime = session.execute(
        sa.select(sa.func.clock_timestamp(type_=sa.DateTime(timezone=True)))
    ).scalar_one()
    return now


def _exports_waiting(session: Session) -> FilesWaiting:
    states = {state: _count(session, Export.state == state) for state in UNDER_WAY}
    return FilesWaiting(
        states, _oldest(session, sa.select(Export.requested_at).where(Export.state.in_(UNDER_WAY)))
    )


def _releases_waiting(session: Session) -> FilesWaiting:
    """Return pending releases; a changing one waits since the first erasure it must apply, not since it was frozen."""
    states = {state: _count(session, Release.state == state) for state in (*UNDER_WAY, "changing")}
    requested = sa.union_all(
        sa.select(Release.requested_at).where(Release.state.in_(UNDER_WAY)),
        sa.select(ReleaseChange.requested_at),
    ).subquery()
    return FilesWaiting(states, _oldest(session, sa.select(requested.c.requested_at)))


def _count(session: Session, *conditions: sa.ColumnElement[bool]) -> int:
    rows = sa.select(sa.literal(1)).where(*conditions).limit(COUNTED_AT_MOST).subquery()
    return session.scalar(sa.select(sa.func.count()).select_from(rows)) or 0


def _oldest(session: Session, times: sa.Select[datetime]) -> datetime | None:
    """Return the earliest of these times, of at most COUNTED_AT_MOST rows."""
    rows = times.limit(COUNTED_AT_MOST).subquery()
    first: datetime | None = session.scalar(sa.select(sa.func.min(rows.c[0])))
    return first


@dataclass(frozen=True, slots=True)
class LastBackup:
    """The last completed `tada backup`.

    damaged: blobs that it lacks because they were damaged or missing.

    piped: it was sent to another program, which may not have stored it.
    """

    made_at: datetime
    damaged: int
    piped: bool = False


def last_backup(session: Session) -> LastBackup | None:
    """Return the last backup, or None; uses an index, so that later events do not slow it down."""
    query = (
        sa.select(AuditEvent.at, AuditEvent.details)
        .where(IS_BACKUP)
        .order_by(AuditEvent.id.desc())
        .limit(1)
    )
    row = session.execute(query).first()
    if row is None:
        return None
    return LastBackup(
        row.at, int(row.details.get("damaged", 0)), piped=bool(row.details.get("piped", False))
    )


def first_event_at(session: Session) -> datetime | None:
    """Return the time of the audit log's first event, when the deployment began; None: no event yet."""
    first: datetime | None = session.scalar(
        sa.select(AuditEvent.at).order_by(AuditEvent.id).limit(1)
    )
    return first


@dataclass(frozen=True, slots=True)
class PostgresFacts:
    """settings: as seen by this connection. connections: of all clients now."""

    settings: Mapping[str, str]
    connections: int


def postgres_facts(session: Session) -> PostgresFacts:
    """Return facts about the server and our connection to it."""
    rows = session.execute(
        sa.text("SELECT name, setting FROM pg_settings WHERE name = ANY(:names)"),
        {"names": list(PG_SETTINGS)},
    )
    count = session.scalar(
        sa.text("SELECT count(*) FROM pg_stat_activity WHERE backend_type = 'client backend'")
    )
    return PostgresFacts({row.name: row.setting for row in rows}, count or 0)


def journal_mode(session: Session) -> str:
    """Return SQLite's journal mode."""
    mode: str = session.execute(sa.text("PRAGMA journal_mode")).scalar_one()
    return mode


def last_event_at(session: Session) -> datetime | None:
    """Return the time of the newest event of the audit log, as recorded."""
    return session.scalar(sa.select(AuditEvent.at).order_by(AuditEvent.id.desc()).limit(1))


def failures_since(session: Session, since: datetime) -> dict[str, int]:
    """Return failure code -> number of meals submitted since then that failed with it."""
    recent = (
        sa.select(Meal.failure_code)
        .where(Meal.status == "failed", Meal.submitted_at >= since)
        .limit(COUNTED_AT_MOST)
        .subquery()
    )
    code = recent.c.failure_code
    rows = session.execute(sa.select(code, sa.func.count()).where(code.is_not(None)).group_by(code))
    return {str(row[0]): row[1] for row in rows}


def newest_photographs(session: Session, limit: int) -> list[tuple[str, str]]:
    """Return (blob key, SHA-256 as stored) of photographs of the newest meals."""
    rows = session.execute(
        sa.select(MealImage.blob_key, MealImage.stored_sha256)
        .join(Meal, Meal.id == MealImage.meal_id)
        .where(
            Meal.status.in_(
                ("queued", "processing", "estimated", "needs_review", "failed", "confirmed")
            )
        )
        .where(MealImage.erased_at.is_(None))
        .order_by(Meal.submitted_at.desc())
        .limit(limit)
    )
    return [(key, sha256) for key, sha256 in rows]


def failing_deliveries(session: Session, least_attempts: int) -> int:
    """Return the number of waiting deliveries with at least this many failed attempts."""
    return _count(
        session,
        WebhookDelivery.state == "waiting",
        WebhookDelivery.attempts >= least_attempts,
    )


def a_sealed_secret(session: Session) -> str | None:
    """Return the sealed secret of the newest webhook."""
    return session.scalar(
        sa.select(Webhook.secret_sealed).order_by(Webhook.created_at.desc()).limit(1)
    )


def deletions_before(session: Session, before: datetime) -> int:
    """Return the number of blobs whose deletion was requested before this time and is still pending."""
    return _count(session, BlobDeletion.requested_at < before)
