"""Webhooks and their deliveries over the wire."""

import uuid
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.api.schemas.text import Text

EventName = Literal[
    "*",
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
Url = Annotated[Text, Field(min_length=1, max_length=500, description="https, to a public address.")]
Events = Annotated[list[EventName], Field(min_length=1, max_length=20, description="`*`: all, later ones too.")]


class WebhookIn(BaseModel):
    """A new webhook."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {"url": "https://hooks.example.org/tada", "events": ["meal.estimated", "meal.confirmed"]}
        },
    )

    url: Url
    events: Events


class WebhookChangeIn(BaseModel):
    """What to change; what is left out stays."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"is_enabled": True}})

    url: Url | None = None
    events: Events | None = None
    is_enabled: bool | None = None

    @model_validator(mode="after")
    def _changes_something(self) -> "WebhookChangeIn":
        if self.url is None and self.events is None and self.is_enabled is None:
            raise ValueError("name url, events or is_enabled")
        return self


class WebhookOut(BaseModel):
    """A webhook. disabled_at: since then nothing is sent to it."""

    id: uuid.UUID
    url: str
    events: list[str]
    author: str
    version: int
    created_at: datetime
    disabled_at: datetime | None


class WebhookList(BaseModel):
    """A study's webhooks, the newest first, at most 100."""

    items: list[WebhookOut]


class WebhookSecretOut(BaseModel):
    """The secret that deliveries are signed with, shown once."""

    webhook: WebhookOut
    secret: str = Field(description="whsec_ and the key in base64, as libraries for Standard Webhooks take it.")
    previous_until: datetime | None = Field(description="Until then the old secret signs along; null: there is none.")


class DeliveryOut(BaseModel):
    """One event for one webhook, and how far its delivery is."""

    id: uuid.UUID = Field(description="The header Webhook-Id; the same at every try.")
    event: str
    payload: dict[str, Any]
    state: Literal["waiting", "delivered", "given_up"]
    attempts: int
    next_try_at: datetime | None
    last_status: int | None
    last_error: str | None
    created_at: datetime
    delivered_at: datetime | None


class DeliveryPage(BaseModel):
    """Deliveries, the newest first. next: the following page."""

    items: list[DeliveryOut]
    next: str | None
