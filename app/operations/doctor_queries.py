"""SQL of what only `tada doctor` asks: how PostgreSQL is set, what failed lately, samples of what is kept."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.models import Meal, MealImage
from app.outbox.models import Webhook, WebhookDelivery
from app.people.privacy_models import AuditEvent, BlobDeletion

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
COUNTED_AT_MOST = 100_000


@dataclass(frozen=True, slots=True)
class PostgresFacts:
    """settings: as this connection sees them. connections: of all clients now."""

    settings: Mapping[str, str]
    connections: int


def postgres_facts(session: Session) -> PostgresFacts:
    """Of the server and of our connection to it."""
    rows = session.execute(
        sa.text("SELECT name, setting FROM pg_settings WHERE name = ANY(:names)"), {"names": list(PG_SETTINGS)}
    )
    count = session.scalar(sa.text("SELECT count(*) FROM pg_stat_activity WHERE backend_type = 'client backend'"))
    return PostgresFacts({row.name: row.setting for row in rows}, count or 0)


def journal_mode(session: Session) -> str:
    """SQLite's."""
    mode: str = session.execute(sa.text("PRAGMA journal_mode")).scalar_one()
    return mode


def last_event_at(session: Session) -> datetime | None:
    """When the newest event of the audit log was, by the clock of then."""
    return session.scalar(sa.select(AuditEvent.at).order_by(AuditEvent.id.desc()).limit(1))


def failures_since(session: Session, since: datetime) -> dict[str, int]:
    """Code -> meals submitted since then that failed by it."""
    recent = (
        sa.select(Meal.failure_code)
        .where(Meal.status == "failed", Meal.submitted_at >= since)
        .limit(COUNTED_AT_MOST)
        .subquery()
    )
    code = recent.c.failure_code
    rows = session.execute(sa.select(code, sa.func.count()).where(code.is_not(None)).group_by(code))
    return {str(failed[0]): failed[1] for failed in rows}


def newest_photographs(session: Session, limit: int) -> list[tuple[str, str]]:
    """(blob key, SHA-256 of what was sealed) of the meals that came last."""
    rows = session.execute(
        sa.select(MealImage.blob_key, MealImage.stored_sha256)
        .join(Meal, Meal.id == MealImage.meal_id)
        .where(Meal.status.in_(("queued", "processing", "estimated", "needs_review", "failed", "confirmed")))
        .where(MealImage.erased_at.is_(None))
        .order_by(Meal.submitted_at.desc())
        .limit(limit)
    )
    return [(key, sha256) for key, sha256 in rows]


def failing_deliveries(session: Session, least_attempts: int) -> int:
    """Deliveries that wait and have failed so often."""
    rows = (
        sa.select(sa.literal(1))
        .where(WebhookDelivery.state == "waiting", WebhookDelivery.attempts >= least_attempts)
        .limit(COUNTED_AT_MOST)
        .subquery()
    )
    return session.scalar(sa.select(sa.func.count()).select_from(rows)) or 0


def a_sealed_secret(session: Session) -> str | None:
    """The newest webhook's."""
    return session.scalar(sa.select(Webhook.secret_sealed).order_by(Webhook.created_at.desc()).limit(1))


def deletions_before(session: Session, before: datetime) -> int:
    """Blobs that an erasure wanted gone by then and that are still there."""
    rows = sa.select(sa.literal(1)).where(BlobDeletion.requested_at < before).limit(COUNTED_AT_MOST).subquery()
    return session.scalar(sa.select(sa.func.count()).select_from(rows)) or 0
