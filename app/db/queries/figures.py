"""SQL of the figures that /metrics and `tada doctor` tell of a deployment: each one is answered from an index.

Nothing here counts what a study gathers in years (estimated meals, records): such a count grows with the data, and a
scrape may not.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import AuditEvent, BlobDeletion, Job, Meal, Webhook, WebhookDelivery
from app.db.models.privacy import IS_BACKUP

OPEN_STATUSES = ("receiving", "queued", "processing", "needs_review")  # of meals that somebody is still to move on
COUNTED_AT_MOST = 100_000  # rows of one kind: who has more needs no closer figure


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
    )


def database_now(session: Session) -> datetime:
    """The database's clock: on SQLite this machine's."""
    if session.get_bind().dialect.name == "sqlite":
        return datetime.now(UTC)
    now: datetime = session.execute(sa.select(sa.func.clock_timestamp(type_=sa.DateTime(timezone=True)))).scalar_one()
    return now


def _count(session: Session, condition: sa.ColumnElement[bool]) -> int:
    rows = sa.select(sa.literal(1)).where(condition).limit(COUNTED_AT_MOST).subquery()
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
