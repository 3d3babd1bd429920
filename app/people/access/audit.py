"""Write the audit log: every read of photographs and every change, in the transaction of the action itself.

People appear by alias. Events never contain a password, token, code, name of an eaten food, or free
text.
"""

import uuid
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.people.access.caller import Caller, DeviceCaller, StaffCaller
from app.people.privacy_models import AuditEvent


def note(
    session: Session,
    caller: Caller | None,
    action: str,
    *,
    study_id: uuid.UUID | None = None,
    subject: uuid.UUID | str | None = None,
    **details: object,
) -> None:
    """Write an event. caller None: the server itself. action: such as "study.change".

    subject: an alias, or an id or code that is not a person's. details: field names, counts, codes;
    JSON values.
    """
    kind, actor = _actor(caller)
    if study_id is None and isinstance(caller, DeviceCaller):
        study_id = caller.study_id
    session.add(
        AuditEvent(
            at=datetime.now(UTC),
            study_id=study_id,
            actor_kind=kind,
            actor=actor,
            action=action,
            subject=str(subject) if subject is not None else None,
            details=details,
            request_id=structlog.contextvars.get_contextvars().get("request_id"),
        )
    )


def _actor(caller: Caller | None) -> tuple[str, str]:
    if isinstance(caller, StaffCaller):
        return "staff", caller.name
    if isinstance(caller, DeviceCaller):
        return "device", str(caller.participant_alias)
    return "system", "system"
