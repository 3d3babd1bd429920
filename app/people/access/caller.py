"""Who calls: a bearer token to a `Caller`, or UnauthenticatedError. Tokens are opaque; only their SHA-256 is stored."""

import hashlib
import secrets
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Literal

from app.core.errors import GoneError, NotAllowedError, UnauthenticatedError
from app.db.session import Database
from app.people import queries as people
from app.people.access.secret_box import SecretBox
from app.people.models import Role

TOKEN_BYTES = 32  # 256 bits
CODE_BYTES = 16  # 128 bits
SESSION_IDLE = timedelta(hours=2)  # a session that is not used for so long has ended; its use is noted every 5 minutes


@dataclass(frozen=True, slots=True)
class DeviceCaller:
    """A participant's phone. participant_alias: its participant's name in the audit log."""

    device_id: uuid.UUID
    participant_id: uuid.UUID
    study_id: uuid.UUID
    participant_alias: uuid.UUID


@dataclass(frozen=True, slots=True)
class StaffCaller:
    """A person who runs the server or works with the data, by a session or a token of their own.

    roles: study -> role, as far as the token reaches. needs: the role that the called route asks for (access_rules.py);
    what the caller may see and do is decided by it in access.py. can_write: the token's scope. kind: signed in
    with the password ("session"), or by a token made for scripts.
    """

    staff_id: uuid.UUID
    name: str
    is_admin: bool
    token_id: uuid.UUID
    roles: Mapping[uuid.UUID, Role] = field(default_factory=dict)
    needs: Role = "viewer"
    can_write: bool = True
    only_study_id: uuid.UUID | None = None
    kind: Literal["session", "personal"] = "personal"


Caller = DeviceCaller | StaffCaller


def authenticate(database: Database, box: SecretBox, token: str) -> Caller:
    """The caller whom a token belongs to.

    Raises UnauthenticatedError for a token unknown, expired or revoked, in the same words; GoneError (`withdrawn`) for
    one whose participant has left the study.
    """
    token_sha256, now = sha256_hex(token), datetime.now(UTC)
    with database.read() as session:
        row = people.find_token(session, token_sha256, now, idle_since=now - SESSION_IDLE)
        if row is None:
            if people.has_tombstone(session, "token", box.digest("token", token_sha256)):
                raise GoneError("This participant has left the study.", code="withdrawn")
            raise UnauthenticatedError("The token is unknown, expired or revoked.")
        if row.staff_id is None:
            return DeviceCaller(row.device_id, row.participant_id, row.study_id, row.participant_alias)
        roles = people.roles_of(session, row.staff_id)
    only = row.only_study_id
    if only is not None:  # no more than the token reaches, whatever its owner may do
        roles = {only: "owner"} if row.is_admin else {study: role for study, role in roles.items() if study == only}
    return StaffCaller(
        staff_id=row.staff_id,
        name=row.staff_name,
        is_admin=row.is_admin and only is None,
        token_id=row.token_id,
        roles=roles,
        can_write=row.scope == "write",
        only_study_id=only,
        kind=row.kind,
    )


def require_device(caller: Caller) -> DeviceCaller:
    """A call that only a participant's phone can make."""
    if isinstance(caller, DeviceCaller):
        return caller
    raise NotAllowedError("Only a participant's device can do this: use a device token.", code="device_only")


def require_staff(caller: Caller) -> StaffCaller:
    """A call that only staff can make."""
    if isinstance(caller, StaffCaller):
        return caller
    raise NotAllowedError("Only staff can do this: use a staff member's token.", code="staff_only")


def new_token() -> str:
    """A fresh token. `tada_` lets secret scanners find one that was leaked."""
    return "tada_" + secrets.token_urlsafe(TOKEN_BYTES)


def new_code() -> str:
    """A fresh enrolment code of 128 bits."""
    return secrets.token_urlsafe(CODE_BYTES)


def sha256_hex(secret: str) -> str:
    """What is stored of a token or code. A secret of 128 random bits needs no slow hash."""
    return hashlib.sha256(secret.encode()).hexdigest()
