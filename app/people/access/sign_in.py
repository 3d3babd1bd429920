"""Staff sign in with name and password, out, and change their password. Every refusal sounds and lasts the same."""

import uuid
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from app.core.errors import InvalidInputError, UnauthenticatedError
from app.db.session import Database
from app.people import queries as people
from app.people.access.access_tokens import EndedAccess, end_access
from app.people.access.audit import note
from app.people.access.caller import SESSION_IDLE, StaffCaller, new_token, sha256_hex
from app.people.access.passwords import Passwords
from app.people.access.staff import normal_name
from app.people.models import AccessToken, Role, Staff

MINUTE = timedelta(minutes=1)
SESSION_VALID = timedelta(hours=12)  # a working day
SESSIONS_KEPT = timedelta(days=30)  # rows of ended ones


@dataclass(frozen=True, slots=True)
class IssuedSession:
    """A session's token, shown once; it also ends after `idle_minutes` without use."""

    token: str
    name: str
    is_admin: bool
    expires_at: datetime
    idle_minutes: int


@dataclass(frozen=True, slots=True)
class SessionView:
    """Who is signed in, and as what in which study (by code)."""

    name: str
    is_admin: bool
    roles: dict[str, Role]
    expires_at: datetime


def sign_in(database: Database, passwords: Passwords, name: str, password: str) -> IssuedSession:
    """A new session. Raises UnauthenticatedError (`sign_in_failed`): name unknown, password wrong, disabled alike."""
    with database.read() as session:
        found = people.find_staff(session, normal_name(name))
    checked = found.password_hash if found is not None else None
    try:
        verdict = passwords.check(password, checked)
    except InvalidInputError:
        raise _failed() from None
    if found is None or found.disabled_at is not None or not verdict.is_right:
        raise _failed()
    token, now = new_token(), datetime.now(UTC)
    with database.write() as session:
        staff = people.find_staff(session, found.name, lock=True)
        if staff is None or staff.disabled_at is not None or staff.password_hash != checked:
            raise _failed()  # disabled, or given another password meanwhile
        if verdict.fresh_hash is not None:
            staff.password_hash = verdict.fresh_hash
        people.forget_sessions(session, staff.id, now - SESSIONS_KEPT)
        row = AccessToken(
            id=uuid.uuid4(),
            token_sha256=sha256_hex(token),
            kind="session",
            staff_id=staff.id,
            created_at=now,
            expires_at=now + SESSION_VALID,
        )
        session.add(row)
        note(session, StaffCaller(staff.id, staff.name, staff.is_admin, row.id), "session.open")
    return IssuedSession(token, staff.name, staff.is_admin, now + SESSION_VALID, SESSION_IDLE // MINUTE)


def read_session(database: Database, caller: StaffCaller) -> SessionView:
    """Who is signed in."""
    with database.read() as session:
        codes = people.codes_of_studies(session, caller.roles.keys())
        row = session.get_one(AccessToken, caller.token_id)
    roles = {codes[study]: role for study, role in caller.roles.items() if study in codes}
    expires_at = row.expires_at or datetime.now(UTC) + SESSION_VALID
    return SessionView(caller.name, caller.is_admin, dict(sorted(roles.items())), expires_at)


def sign_out(database: Database, caller: StaffCaller) -> None:
    """End the session."""
    with database.write() as session:
        session.get_one(AccessToken, caller.token_id).revoked_at = datetime.now(UTC)
        note(session, caller, "session.end")


def change_own_password(
    database: Database, passwords: Passwords, caller: StaffCaller, *, current: str, new: str
) -> EndedAccess:
    """Another password; ends all sessions, this one too, and all personal tokens.

    Raises UnauthenticatedError (`sign_in_failed`: the current one is wrong), InvalidInputError (`password_refused`).
    """
    with database.read() as session:
        checked = session.get_one(Staff, caller.staff_id).password_hash
    if not passwords.check(current, checked).is_right:
        raise _failed()
    if new == current:
        raise InvalidInputError("The new password is the one that you have.", code="password_refused")
    hashed, now = passwords.hash(new, name=caller.name), datetime.now(UTC)
    with database.write() as session:
        staff = people.find_staff(session, caller.name, lock=True)
        if staff is None or staff.password_hash != checked:
            raise _failed()
        staff.password_hash = hashed
        ended = end_access(session, staff.id, now)
        note(
            session,
            caller,
            "staff.password",
            subject=staff.name,
            sessions_ended=ended.sessions,
            tokens_ended=len(ended.tokens),
        )
    return ended


def _failed() -> UnauthenticatedError:
    return UnauthenticatedError("Name or password are wrong, or the account is disabled.", code="sign_in_failed")
