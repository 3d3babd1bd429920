"""Who calls, and what they may see and do in a study: a bearer token to a `Caller`, or UnauthenticatedError.

Tokens are opaque; only their SHA-256 is stored. The route's rule (access_rules.py) has put into the caller which role
it needs. A study where the caller has no role at all does not exist for them: 404. One where the role is too low says
so: 403. An admin has every role everywhere.
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

    roles: study -> role, as far as the token reaches. needs: the role that the called route asks for (access_rules.py).
    can_write: the token's scope. kind: signed in with the password ("session"), or by a token made for scripts.
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
        access, staff, device, participant = row
        if access.staff_id is None:
            return DeviceCaller(device.id, participant.id, participant.study_id, participant.alias)
        roles = people.roles_of(session, staff.id)
    only = access.study_id
    if only is not None:  # no more than the token reaches, whatever its owner may do
        roles = {only: "owner"} if staff.is_admin else {study: role for study, role in roles.items() if study == only}
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
    """A call that only a participant's phone can make."""
    if isinstance(caller, DeviceCaller):
        return caller
    raise NotAllowedError("Only a participant's device can do this: use a device token.", code="device_only")


def require_staff(caller: Caller) -> StaffCaller:
    """A call that only staff can make."""
    if isinstance(caller, StaffCaller):
        return caller
    raise NotAllowedError("Only staff can do this: use a staff member's token.", code="staff_only")


def role_in(caller: StaffCaller, study_id: uuid.UUID) -> Role | None:
    """The caller's role in a study, or None."""
    return "owner" if caller.is_admin else caller.roles.get(study_id)


def visible_studies(caller: Caller) -> frozenset[uuid.UUID] | None:
    """The studies whose data the called route may show to this caller; None: all. A phone has its own."""
    if isinstance(caller, DeviceCaller):
        return frozenset({caller.study_id})
    if caller.is_admin:
        return None
    return frozenset(study for study, role in caller.roles.items() if reaches(role, caller.needs))


def visible_rows(caller: Caller, chosen: RowFilter) -> RowFilter:
    """Limit the filter to what the caller may see: a phone its participant's rows, staff those of their studies."""
    visible = replace(chosen, study_ids=visible_studies(caller))
    return replace(visible, participant_id=caller.participant_id) if isinstance(caller, DeviceCaller) else visible


def known_studies(caller: Caller) -> frozenset[uuid.UUID] | None:
    """The studies that exist for this caller, whatever their role there; None: all."""
    if isinstance(caller, DeviceCaller):
        return frozenset({caller.study_id})
    return None if caller.is_admin else frozenset(caller.roles)


def require_study(caller: Caller, study_id: uuid.UUID, what: str = "study") -> None:
    """Let the caller into a study, or raise: NotFoundError where it is not theirs, NotAllowedError for a lower role."""
    if isinstance(caller, DeviceCaller):
        if caller.study_id != study_id:
            raise NotFoundError(f"There is no such {what}.")
        return
    role = role_in(caller, study_id)
    if role is None:
        raise NotFoundError(f"There is no such {what}.")
    if not reaches(role, caller.needs):
        raise NotAllowedError(
            f"This needs the role {caller.needs} in the study; you are {role}.", code="role_too_low", needs=caller.needs
        )


def reaches(role: Role | None, needed: Role) -> bool:
    """Whether a role is at least another one."""
    return role is not None and ROLES.index(role) >= ROLES.index(needed)


def new_token() -> str:
    """A fresh token. `tada_` lets secret scanners find one that was leaked."""
    return "tada_" + secrets.token_urlsafe(TOKEN_BYTES)


def new_code() -> str:
    """A fresh enrolment code of 128 bits."""
    return secrets.token_urlsafe(CODE_BYTES)


def sha256_hex(secret: str) -> str:
    """What is stored of a token or code. A secret of 128 random bits needs no slow hash."""
    return hashlib.sha256(secret.encode()).hexdigest()
