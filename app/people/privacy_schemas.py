"""Receipts of erasures and the audit log over the wire."""

import uuid
from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field

from app.http.field_descriptions import NEXT, PAGE
from app.people.privacy_models import ActorKind, ErasedWhat, ErasurePolicy


class ReceiptOut(BaseModel):
    """What an erasure removed, in numbers; it names nobody. Keep its id: whoever has it may ask for it again."""

    id: uuid.UUID = Field(description="The receipt's id.")
    what: ErasedWhat = Field(description="participant, meal or photographs")
    policy: ErasurePolicy = Field(
        description="keep, anonymise, erase; or retention: the study's time for photographs was over."
    )
    counts: dict[str, int] = Field(description="How many of each kind of row were removed, or changed by their name.")
    erased_at: datetime = Field(description="When it was erased.")


class AuditEventOut(BaseModel):
    """One read of photographs or one change. People appear by an alias that only their row resolves."""

    id: int = Field(description="Grows with each event.")
    at: datetime = Field(description="When it happened.")
    study: str | None = Field(description="The study's code; null: the event is of no study, or the study is gone.")
    actor_kind: ActorKind = Field(description="staff, device or system")
    actor: str = Field(description="A staff member's name, a participant's alias, or system.")
    action: str = Field(description="What was done, such as photograph.read or study.change.")
    subject: str | None = Field(description="Alias or name of what it was done to; null: of nothing in particular.")
    details: dict[str, Any] = Field(description="What else is known of it; the fields depend on the action.")
    request_id: str | None = Field(description="The request's id in the server's log; null: no request did it.")


class AuditPage(BaseModel):
    """Events in their order; `next` is the page behind it, or null."""

    items: list[AuditEventOut] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)
