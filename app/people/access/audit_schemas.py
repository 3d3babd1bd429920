"""HTTP schemas of the audit log."""

from datetime import datetime

from pydantic import BaseModel, Field

from app.http.field_descriptions import NEXT, PAGE
from app.people.privacy_models import ActorKind


class AuditEventOut(BaseModel):
    """A read of photographs or a change. People appear by an alias that only their row resolves."""

    id: int = Field(description="Grows with each event.")
    at: datetime = Field(description="When it happened.")
    study: str | None = Field(
        description="The study's code; null: the event belongs to no existing study."
    )
    actor_kind: ActorKind = Field(description="staff, device or system")
    actor: str = Field(description="A staff member's name, a participant's alias, or system.")
    action: str = Field(description="What was done, such as photograph.read or study.change.")
    subject: str | None = Field(
        description="Alias or name of the person or object concerned; null: none."
    )
    details: dict[str, object] = Field(
        description="Further details; the fields depend on the action."
    )
    request_id: str | None = Field(
        description="The request's id in the server's log; null: not caused by a request."
    )


class AuditPage(BaseModel):
    """A page of events in order; `next` is the address of the next page, or null."""

    items: list[AuditEventOut] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)
