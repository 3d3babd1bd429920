"""The caller of a request and their rights in studies: a bearer token gives a `Caller` or UnauthenticatedError.

Tokens are opaque; only their SHA-256 is stored. The route's rule (access_rules.py) sets the role
that the caller needs. A study in which the caller has no role answers 404, one in which the role is
too low 403. An admin has every role in every study.
"""

import hashlib
import secrets
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Literal

from app.core.errors import GoneError, NotAllowedError, NotFoundError, UnauthenticatedError
from app.db.session import Database
from app.http.row_filter import RowFilter
from app.people import queries as people
from app.people.access.secret_box import SecretBox
from app.people.models import ROLES, Role

TOKEN_BYTES = 32  # 256 bits
CODE_BYTES = 16  # 128 bits
# an unused session ends after it; its last use is stored every 5 minutes
SESSION_IDLE = timedelta(hours=2)


@dataclass(frozen=True, slots=True)
class DeviceCaller:
    """A participant's phone. participant_alias: the participant's name in the audit log."""

    device_id: uuid.UUID
    participant_id: uuid.UUID
    study_id: uuid.UUID
    participant_alias: uuid.UUID


@dataclass(frozen=True, slots=True)
class StaffCaller:
    """A person who runs the server or works with the data, by a session or a personal token.

    roles: role by study, restricted to the token's study. needs: the role that the route requires
    (access_rules.py). can_write: the token's scope. kind: signed in with a password ("session"), or
    with a token created for scripts.
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
    """Return the caller whom a token belongs to.

    Raises UnauthenticatedError with the same message for an unknown, expired or revoked token,
    GoneError (`withdrawn`) for a token whose participant has left the study, with the id of the
    withdrawal's `receipt`.
    """
    token_sha256, now = sha256_hex(token), datetime.now(UTC)
    with database.read() as session:
        row = people.find_token(session, token_sha256, now, idle_since=now - SESSION_IDLE)
        if row is None:
            ended = people.find_tombstone(session, "token", box.digest("token", token_sha256))
            if ended is not None:
                receipt = people.receipt_of_erasure(session, ended, "participant")
                facts = {"receipt": str(receipt)} if receipt is not None else {}
                raise GoneError("This participant has left the study.", code="withdrawn", **facts)
            raise UnauthenticatedError("The token is unknown, expired or revoked.")
        access, staff, device, participant = row
        if access.staff_id is None:
            return DeviceCaller(device.id, participant.id, participant.study_id, participant.alias)
        roles = people.roles_of(session, staff.id)
    only = access.study_id
    if only is not None:  # the token is restricted to this study, whatever its owner's roles are
        roles = (
            {only: "owner"}
            if staff.is_admin
            else {study: role for study, role in roles.items() if study == only}
        )
    return StaffCaller(
        staff_id=staff.id,
        name=staff.name,
        is_admin=staff.is_admin and only is None,
        token_id=access.id,
        roles=roles,
        can_write=access.scope == "write",
        only_study_id=only,
        kind="session" if access.kind == "session" else "personal",
    )


def require_device(caller: Caller) -> DeviceCaller:
    """Return the caller if it is a participant's phone. Raises NotAllowedError (`device_only`)."""
    if isinstance(caller, DeviceCaller):
        return caller
    raise NotAllowedError(
        "Only a participant's device can do this: use a device token.", code="device_only"
    )


def require_staff(caller: Caller) -> StaffCaller:
    """Return the caller if it is a staff member. Raises NotAllowedError (`staff_only`)."""
    if isinstance(caller, StaffCaller):
        return caller
    raise NotAllowedError("Only staff can do this: use a staff member's token.", code="staff_only")


def role_in(caller: StaffCaller, study_id: uuid.UUID) -> Role | None:
    """Return the caller's role in a study, or None."""
    return "owner" if caller.is_admin else caller.roles.get(study_id)


def visible_studies(caller: Caller) -> frozenset[uuid.UUID] | None:
    """Return the studies whose data the route may show to the caller; None: all.

    A phone may see its own study.
    """
    if isinstance(caller, DeviceCaller):
        return frozenset({caller.study_id})
    if caller.is_admin:
        return None
    return frozenset(study for study, role in caller.roles.items() if reaches(role, caller.needs))


def visible_rows(caller: Caller, chosen: RowFilter) -> RowFilter:
    """Limit a filter to rows that the caller may see: a phone its participant's, staff those of their studies."""
    visible = replace(chosen, study_ids=visible_studies(caller))
    return (
        replace(visible, participant_id=caller.participant_id)
        if isinstance(caller, DeviceCaller)
        else visible
    )


def studies_with_role(caller: Caller) -> frozenset[uuid.UUID] | None:
    """Return the studies in which the caller has any role; None: all."""
    if isinstance(caller, DeviceCaller):
        return frozenset({caller.study_id})
    return None if caller.is_admin else frozenset(caller.roles)


def require_study(caller: Caller, study_id: uuid.UUID, resource: str = "study") -> None:
    """Check that the caller may access a study, or a resource in it.

    Raises NotFoundError if they have no role in it, NotAllowedError (`role_too_low`).
    """
    if isinstance(caller, DeviceCaller):
        if caller.study_id != study_id:
            raise NotFoundError(f"There is no such {resource}.")
        return
    role = role_in(caller, study_id)
    if role is None:
        raise NotFoundError(f"There is no such {resource}.")
    if not reaches(role, caller.needs):
        raise NotAllowedError(
            f"This needs the role {caller.needs} in the study; you are {role}.",
            code="role_too_low",
            needs=caller.needs,
        )


def reaches(role: Role | None, needed: Role) -> bool:
    """Whether a role includes the rights of another role."""
    return role is not None and ROLES.index(role) >= ROLES.index(needed)


def new_token() -> str:
    """Draw a token. The prefix `tada_` lets secret scanners find leaked tokens."""
    return token_of(secrets.token_urlsafe(TOKEN_BYTES))


def token_of(secret: str) -> str:
    """Return the token made of 256 secret bits as text."""
    return f"tada_{secret}"


def new_code() -> str:
    """Draw an enrolment code of 128 bits."""
    return secrets.token_urlsafe(CODE_BYTES)


def sha256_hex(secret: str) -> str:
    """Hash a token or code for storage. A secret of 128 random bits needs no slow hash."""
    return hashlib.sha256(secret.encode()).hexdigest()
