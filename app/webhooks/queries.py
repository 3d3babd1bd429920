"""SQL of webhooks and their deliveries."""

import uuid
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.stored.models import Meal
from app.outbox.models import Webhook, WebhookDelivery
from app.people.models import Participant, Study


@dataclass(frozen=True, slots=True)
class Due:
    """Selects deliveries to enabled webhooks that are due: of one webhook only, or of all except some."""

    now: datetime
    excluded: frozenset[uuid.UUID] = frozenset()
    only: uuid.UUID | None = None


def list_webhooks(session: Session, study_id: uuid.UUID, limit: int) -> list[Webhook]:
    """Return a study's webhooks, including disabled ones, the newest first."""
    query = sa.select(Webhook).where(Webhook.study_id == study_id)
    return list(session.scalars(query.order_by(Webhook.created_at.desc(), Webhook.id).limit(limit)))


def lock_study(session: Session, study_id: uuid.UUID) -> None:
    """Lock the study until commit, so that concurrent changes count its webhooks one after the other."""
    session.execute(sa.select(Study.id).where(Study.id == study_id).with_for_update(key_share=True))


def find_webhook(
    session: Session, study_id: uuid.UUID, webhook_id: uuid.UUID, *, lock: bool = False
) -> Webhook | None:
    """Return a webhook of this study, locked until commit if `lock` is set."""
    query = sa.select(Webhook).where(Webhook.id == webhook_id, Webhook.study_id == study_id)
    return session.scalars(query.with_for_update(key_share=True) if lock else query).one_or_none()


def find_delivery(
    session: Session, webhook_id: uuid.UUID, delivery_id: uuid.UUID
) -> WebhookDelivery | None:
    """Return a delivery of this webhook to copy; its participant and meal are locked against erasure."""
    row = WebhookDelivery
    query = sa.select(row).where(row.id == delivery_id, row.webhook_id == webhook_id)
    delivery = session.scalars(query).one_or_none()
    if delivery is None:
        return None
    participant = sa.select(Participant.id).where(Participant.id == delivery.participant_id)
    meal = sa.select(Meal.id).where(Meal.id == delivery.meal_id)
    for owner in (participant, meal):
        session.execute(owner.with_for_update(read=True, key_share=True))
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def page_of_deliveries(
    session: Session,
    webhook_id: uuid.UUID,
    *,
    state: str | None,
    before: tuple[datetime, uuid.UUID] | None,
    limit: int,
) -> list[WebhookDelivery]:
    """Return at most `limit` deliveries before `before`, the newest first by (created_at, id)."""
    row = WebhookDelivery
    query = sa.select(row).where(row.webhook_id == webhook_id)
    if state is not None:
        query = query.where(row.state == state)
    if before is not None:
        bound = sa.tuple_(
            sa.literal(before[0], row.created_at.type), sa.literal(before[1], row.id.type)
        )
        query = query.where(sa.tuple_(row.created_at, row.id) < bound)
    return list(session.scalars(query.order_by(row.created_at.desc(), row.id.desc()).limit(limit)))


def has_due(session: Session, due: Due) -> bool:
    """Whether a delivery is due."""
    return session.scalar(_due(due).with_only_columns(WebhookDelivery.id).limit(1)) is not None


def claim_due(
    session: Session, due: Due, *, until: datetime
) -> tuple[WebhookDelivery, Webhook] | None:
    """Claim the delivery that has waited longest, with its webhook; no other worker gets it before `until`.

    PostgreSQL skips rows that another worker is claiming; SQLite has one writer at a time.
    """
    row = WebhookDelivery
    query = (
        _due(due)
        .order_by(row.next_try_at, row.id)
        .limit(1)
        .with_for_update(of=row, skip_locked=True)
    )
    claimed = session.execute(query).one_or_none()
    if claimed is None:
        return None
    delivery, hook = claimed
    delivery.attempts += 1
    delivery.next_try_at = until
    session.flush()
    return delivery, hook


def lock_delivery(
    session: Session, delivery_id: uuid.UUID
) -> tuple[WebhookDelivery, Webhook] | None:
    """Lock a webhook and then its delivery, in the order used everywhere; None if the delivery was erased."""
    webhook_id = session.scalar(
        sa.select(WebhookDelivery.webhook_id).where(WebhookDelivery.id == delivery_id)
    )
    if webhook_id is None:
        return None
    hook_query = sa.select(Webhook).where(Webhook.id == webhook_id)
    # does not block new deliveries
    hook = session.scalars(hook_query.with_for_update(key_share=True)).one()
    query = sa.select(WebhookDelivery).where(WebhookDelivery.id == delivery_id).with_for_update()
    delivery = session.scalars(query).one_or_none()
    return (delivery, hook) if delivery is not None else None


def last_outcomes(session: Session, webhook_id: uuid.UUID, limit: int) -> list[str]:
    """Return the final states of the newest deliveries that have ended."""
    row = WebhookDelivery
    query = sa.select(row.state).where(row.webhook_id == webhook_id, row.state != "waiting")
    return list(session.scalars(query.order_by(row.created_at.desc(), row.id.desc()).limit(limit)))


def unsendable(
    session: Session, now: datetime, most_attempts: int, limit: int
) -> list[WebhookDelivery]:
    """Return waiting deliveries that will not be sent: webhook disabled, or the worker died in the last attempt."""
    row = WebhookDelivery
    query = (
        sa.select(row)
        .join(Webhook, Webhook.id == row.webhook_id)
        .where(
            row.state == "waiting",
            sa.or_(
                Webhook.disabled_at.is_not(None),
                sa.and_(row.attempts >= most_attempts, row.next_try_at <= now),
            ),
        )
        .limit(limit)
    )
    return list(session.scalars(query.with_for_update(of=row, skip_locked=True)))


def remove_ended(session: Session, before: datetime, limit: int) -> int:
    """Delete at most `limit` deliveries that have ended and were created before a time.

    Returns the number.
    """
    row = WebhookDelivery
    old = sa.select(row.id).where(row.state != "waiting", row.created_at < before).limit(limit)
    removed = session.execute(
        sa.delete(row)
        .where(row.id.in_(old))
        .returning(row.id)
        .execution_options(synchronize_session=False)
    )
    return len(removed.all())


def _due(due: Due) -> sa.Select[WebhookDelivery, Webhook]:
    row = WebhookDelivery
    query = (
        sa.select(row, Webhook)
        .join(Webhook, Webhook.id == row.webhook_id)
        .where(row.state == "waiting", row.next_try_at <= due.now, Webhook.disabled_at.is_(None))
    )
    if due.only is not None:
        query = query.where(row.webhook_id == due.only)
    return query.where(row.webhook_id.not_in(due.excluded)) if due.excluded else query
