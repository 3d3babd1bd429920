"""Who calls: a bearer token to a `Caller`, or UnauthenticatedError. Tokens are opaque; only their SHA-256 is stored."""

import hashlib
import secrets
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime

from app.db.queries import people
from app.db.session import Database
from app.errors import NotAllowedError, UnauthenticatedError

TOKEN_BYTES = 32  # 256 bits
CODE_BYTES = 16  # 128 bits


@dataclass(frozen=True, slots=True)
class DeviceCaller:
    """A participant's phone."""

    device_id: uuid.UUID
    participant_id: uuid.UUID
    study_id: uuid.UUID


@dataclass(frozen=True, slots=True)
class StaffCaller:
    """A person who runs the server."""

    staff_id: uuid.UUID
    is_admin: bool


Caller = DeviceCaller | StaffCaller


def authenticate(database: Database, token: str) -> Caller:
    """The caller whom a token belongs to. Raises UnauthenticatedError for all others, in the same words."""
    with database.read() as session:
        row = people.find_token(session, sha256_hex(token), datetime.now(UTC))
    if row is None:
        raise UnauthenticatedError("The token is unknown, expired or revoked.")
    if row.staff_id is not None:
        return StaffCaller(staff_id=row.staff_id, is_admin=bool(row.is_admin))
    return DeviceCaller(device_id=row.device_id, participant_id=row.participant_id, study_id=row.study_id)


def require_device(caller: Caller) -> DeviceCaller:
    """A call that only a participant's phone can make."""
    if isinstance(caller, DeviceCaller):
        return caller
    raise NotAllowedError("Only a participant's device can do this: use a device token.", code="device_only")


def require_admin(caller: Caller) -> StaffCaller:
    """A call that only an admin can make."""
    if isinstance(caller, StaffCaller) and caller.is_admin:
        return caller
    raise NotAllowedError("Only an admin can do this: use a token from `tada admin create`.", code="admin_only")


def new_token() -> str:
    """A fresh token. `tada_` lets secret scanners find one that was leaked."""
    return "tada_" + secrets.token_urlsafe(TOKEN_BYTES)


def new_code() -> str:
    """A fresh enrolment code of 128 bits."""
    return secrets.token_urlsafe(CODE_BYTES)


def sha256_hex(secret: str) -> str:
    """What is stored of a token or code. A secret of 128 random bits needs no slow hash."""
    return hashlib.sha256(secret.encode()).hexdigest()
