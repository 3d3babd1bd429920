"""HTTP schemas of webhooks and their deliveries."""

import uuid
from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.closed_model import ClosedModel
from app.http.page_of import PageOf
from app.http.text_schemas import Text
from app.outbox.models import DeliveredEvent, DeliveryState, Event

EventName = Literal["*", Event]
Url = Annotated[
    Text, Field(min_length=1, max_length=500, description="https, to a public address.")
]
Events = Annotated[
    list[EventName],
    Field(min_length=1, max_length=20, description="`*`: all events, including future kinds."),
]


class WebhookIn(ClosedModel):
    """A new webhook."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "url": "https://hooks.example.org/tada",
                "events": ["meal.estimated", "meal.confirmed"],
            }
        },
    )

    url: Url
    events: Events


class WebhookChangeIn(ClosedModel):
    """A change of a webhook; fields that are left out stay unchanged."""

    model_config = ConfigDict(json_schema_extra={"example": {"is_enabled": True}})

    url: Url | None = Field(
        default=None, description="The new address, https and public; null: unchanged."
    )
    events: Events | None = Field(
        default=None, description="The new list of events; null: unchanged."
    )
    is_enabled: bool | None = Field(
        default=None, description="Whether deliveries are sent; null: unchanged."
    )

    @model_validator(mode="after")
    def _changes_something(self) -> "WebhookChangeIn":
        if self.url is None and self.events is None and self.is_enabled is None:
            raise ValueError("name url, events or is_enabled")
        return self


class WebhookOut(BaseModel):
    """A webhook."""

    id: uuid.UUID = Field(description="The webhook's id.")
    url: str = Field(description="Where deliveries are sent.")
    events: list[EventName] = Field(
        description="The subscribed events; `*`: all, including future kinds."
    )
    author: str = Field(description="Name of the staff member who created it.")
    version: int = Field(description="Grows with every change of the webhook; the ETag names it.")
    created_at: datetime = Field(description="When it was created.")
    disabled_at: datetime | None = Field(description="When it was disabled; null: it is enabled.")


class WebhookList(BaseModel):
    """A study's webhooks, the newest first, at most 100."""

    items: list[WebhookOut] = Field(description="The study's webhooks.")


class WebhookSecretOut(BaseModel):
    """The secret that deliveries are signed with, shown once."""

    webhook: WebhookOut = Field(description="The webhook that the secret is for.")
    secret: str = Field(
        description="whsec_ and the key in base64, as libraries for Standard Webhooks take it."
    )
    previous_until: datetime | None = Field(
        description="Until when deliveries are also signed with the old secret; null: there is none."
    )


class DeliveryOut(BaseModel):
    """The delivery of one event to one webhook."""

    id: uuid.UUID = Field(description="The header Webhook-Id, the same for every attempt.")
    event: DeliveredEvent = Field(
        description="The event's name, such as meal.estimated; `ping` for a test."
    )
    payload: dict[str, object] = Field(description="The body that is sent.")
    state: DeliveryState = Field(
        description="waiting: to be sent or retried. given_up: it failed too often."
    )
    attempts: int = Field(description="The number of attempts.")
    next_try_at: datetime | None = Field(
        description="When the next attempt is due; null: there is none."
    )
    last_status: int | None = Field(
        description="HTTP status of the last answer; null: there was none."
    )
    last_error: str | None = Field(description="Why the last attempt failed; null: it did not.")
    created_at: datetime = Field(description="When the event happened.")
    delivered_at: datetime | None = Field(description="When it was accepted; null: it was not.")


class DeliveryPage(PageOf[DeliveryOut]):
    """A page of deliveries, the newest first; `next` is the address of the next page, or null."""
