"""Write deliveries for each webhook that subscribes to an event, in the event's own transaction.

The payload is fixed here, so that it describes the state at the time of the event; if the
transaction fails, nothing is sent. Workers send deliveries (webhooks/deliver_webhooks.py).
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
    """Announce an event to the study's webhooks. data: ids, codes, days and counts only.

    meal_id, participant_id: the subject, by which an erasure finds the delivery; None if its row is
    about to be erased.
    """
    subscribers = [
        hook
        for hook in enabled_webhooks(session, study_id)
        if event in hook.events or ALL_EVENTS in hook.events
    ]
    if subscribers:
        deliver_to(
            session, subscribers, event, data, meal_id=meal_id, participant_id=participant_id
        )


def deliver_to(
    session: Session,
    hooks: Iterable[Webhook],
    event: DeliveredEvent,
    data: Mapping[str, object],
    *,
    meal_id: uuid.UUID | None = None,
    participant_id: uuid.UUID | None = None,
) -> list[WebhookDelivery]:
    """Add a delivery, due at once, to each of these webhooks of one study, whatever events they subscribe to."""
    now, event_id = datetime.now(UTC), uuid.uuid4()
    rows = []
    for hook in hooks:
        payload: dict[str, object] = {
            "id": str(event_id),
            "type": event,
            "timestamp": now.isoformat().replace("+00:00", "Z"),
            "data": {"study": session.get_one(Study, hook.study_id).code, **data},
        }
        rows.append(
            add_delivery(
                session, hook, event, payload, now, meal_id=meal_id, participant_id=participant_id
            )
        )
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


def enabled_webhooks(session: Session, study_id: uuid.UUID) -> list[Webhook]:
    """Return a study's enabled webhooks, the oldest first."""
    query = sa.select(Webhook).where(Webhook.study_id == study_id, Webhook.disabled_at.is_(None))
    return list(session.scalars(query.order_by(Webhook.created_at, Webhook.id)))
