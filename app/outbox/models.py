"""A study's webhooks and their deliveries."""

import uuid
from datetime import datetime
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal, one_of
from app.db.columns import (
    MealRef,
    ParticipantRef,
    Str200,
    Str300,
    Str500,
    StudyRef,
    UuidKey,
    Version,
)

DeliveryState = Literal["waiting", "delivered", "given_up"]
DELIVERY_STATES: tuple[DeliveryState, ...] = get_args(DeliveryState)
PING: Literal["ping"] = "ping"  # a test, which cannot be subscribed to
ALL_EVENTS = "*"
Event = Literal[
    "meal.received",
    "meal.estimated",
    "meal.needs_review",
    "meal.failed",
    "meal.confirmed",
    "meal.deleted",
    "day.closed",
    "day.reopened",
    "participant.withdrawn",
]
EVENTS: tuple[Event, ...] = get_args(Event)
DeliveredEvent = Literal[Event, "ping"]


class Webhook(Base):
    """A subscription to a study's events. secret_sealed: encrypted under TADA_SECRET_KEY.

    version grows with every change that the API shows.
    """

    __tablename__ = "webhook"

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef] = mapped_column(index=True)
    url: Mapped[Str500]
    events: Mapped[list[str]]
    secret_sealed: Mapped[Str300]
    author: Mapped[Str200]
    version: Mapped[Version]
    created_at: Mapped[datetime]
    disabled_at: Mapped[datetime | None]


class WebhookDelivery(Base):
    """The delivery of one event to one webhook; the payload is fixed when the event happens.

    meal_id, participant_id: the subject of the event, by which an erasure finds the delivery.
    """

    __tablename__ = "webhook_delivery"
    personal = Personal(("meal_id", "participant_id"), "told_to_others")

    id: Mapped[UuidKey]
    webhook_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("webhook.id"))
    event: Mapped[DeliveredEvent] = mapped_column(sa.String(64))
    payload: Mapped[dict[str, object]]
    meal_id: Mapped[MealRef | None] = mapped_column(index=True)
    participant_id: Mapped[ParticipantRef | None] = mapped_column(index=True)
    state: Mapped[DeliveryState] = mapped_column(sa.String(16))
    attempts: Mapped[int] = mapped_column(default=0)
    next_try_at: Mapped[datetime | None]
    last_status: Mapped[int | None]
    last_error: Mapped[Str200 | None]
    created_at: Mapped[datetime]
    delivered_at: Mapped[datetime | None]

    __table_args__ = (
        one_of("state", DELIVERY_STATES),
        sa.Index(None, "state", "next_try_at"),
        sa.Index(None, "webhook_id", "created_at"),
    )
