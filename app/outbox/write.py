"""The outbox of webhooks: an event becomes a delivery for each webhook that wants it, in the event's own transaction.

What is delivered is frozen here, so a receiver learns how it was when it happened; nothing is sent if the transaction
fails. Sending is the worker's (webhooks/deliver_webhooks.py).
"""

import uuid
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.outbox.models import ALL_EVENTS, DeliveredEvent, Event, Webhook, WebhookDelivery
from app.people.models import Study


def announce(
    session: Session,
    study_id: uuid.UUID,
    event: Event,
    data: Mapping[str, object],
    *,
    meal_id: uuid.UUID | None = None,
    participant_id: uuid.UUID | None = None,
) -> None:
    """Tell the study's webhooks of an event. data: ids, codes, days and counts only.

    meal_id, participant_id: whose it is, so that an erasure finds it; None where their rows are about to go.
    """
    wanting = [hook for hook in enabled_webhooks(session, study_id) if _wants(hook, event)]
    if wanting:
        deliver_to(session, wanting, event, data, meal_id=meal_id, participant_id=participant_id)


def deliver_to(
    session: Session,
    hooks: Iterable[Webhook],
    event: DeliveredEvent,
    data: Mapping[str, object],
    *,
    meal_id: uuid.UUID | None = None,
    participant_id: uuid.UUID | None = None,
) -> list[WebhookDelivery]:
    """A delivery for each of these webhooks, of one study, whatever events they want; due at once."""
    now, event_id = datetime.now(UTC), uuid.uuid4()
    rows = []
    for hook in hooks:
        payload: dict[str, object] = {
            "id": str(event_id),
            "type": event,
            "timestamp": now.isoformat().replace("+00:00", "Z"),
            "data": {"study": session.get_one(Study, hook.study_id).code, **data},
        }
        rows.append(add_delivery(session, hook, event, payload, now, meal_id=meal_id, participant_id=participant_id))
    return rows


def add_delivery(
    session: Session,
    hook: Webhook,
    event: DeliveredEvent,
    payload: dict[str, object],
    now: datetime,
    *,
    meal_id: uuid.UUID | None,
    participant_id: uuid.UUID | None,
) -> WebhookDelivery:
    """Add a delivery that is due at once."""
    row = WebhookDelivery(
        id=uuid.uuid4(),
        webhook_id=hook.id,
        event=event,
        payload=payload,
        meal_id=meal_id,
        participant_id=participant_id,
        state="waiting",
        attempts=0,
        next_try_at=now,
        created_at=now,
    )
    session.add(row)
    return row


def _wants(hook: Webhook, event: str) -> bool:
    return event in hook.events or ALL_EVENTS in hook.events


def enabled_webhooks(session: Session, study_id: uuid.UUID) -> list[Webhook]:
    """A study's webhooks that are told of events, the oldest first."""
    query = sa.select(Webhook).where(Webhook.study_id == study_id, Webhook.disabled_at.is_(None))
    return list(session.scalars(query.order_by(Webhook.created_at, Webhook.id)))
