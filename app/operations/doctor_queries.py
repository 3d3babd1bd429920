"""SQL used only by `tada doctor`: PostgreSQL's settings, recent failures, samples of stored data."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.stored.models import Meal, MealImage
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
    rows = (
        sa.select(sa.literal(1))
        .where(WebhookDelivery.state == "waiting", WebhookDelivery.attempts >= least_attempts)
        .limit(COUNTED_AT_MOST)
        .subquery()
    )
    return session.scalar(sa.select(sa.func.count()).select_from(rows)) or 0


def a_sealed_secret(session: Session) -> str | None:
    """Return the sealed secret of the newest webhook."""
    return session.scalar(
        sa.select(Webhook.secret_sealed).order_by(Webhook.created_at.desc()).limit(1)
    )


def deletions_before(session: Session, before: datetime) -> int:
    """Return the number of blobs whose deletion was requested before this time and is still pending."""
    rows = (
        sa.select(sa.literal(1))
        .where(BlobDeletion.requested_at < before)
        .limit(COUNTED_AT_MOST)
        .subquery()
    )
    return session.scalar(sa.select(sa.func.count()).select_from(rows)) or 0
