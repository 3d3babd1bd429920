"""Receipts of erasures and the audit log over the wire."""

import uuid
from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field


class ReceiptOut(BaseModel):
    """What an erasure removed, in numbers; it names nobody. Keep its id: whoever has it may ask for it again."""

    id: uuid.UUID
    what: str = Field(description="participant, meal or photographs")
    policy: str = Field(description="keep, anonymise, erase; or retention: the study's time for photographs was over.")
    counts: dict[str, int] = Field(description="How many of each kind of row were removed, or changed by their name.")
    erased_at: datetime


class AuditEventOut(BaseModel):
    """One read of photographs or one change. People appear by an alias that only their row resolves."""

    id: int
    at: datetime
    study: str | None
    actor_kind: str = Field(description="staff, device or system")
    actor: str = Field(description="A staff member's name, a participant's alias, or system.")
    action: str
    subject: str | None
    details: dict[str, Any]
    request_id: str | None


class AuditPage(BaseModel):
    """Events in their order; `next` is the page behind it, or null."""

    items: list[AuditEventOut]
    next: str | None
