"""Staff sign in with name and password, sign out, and change their password. All refusals look and take the same."""

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
SESSIONS_KEPT = timedelta(days=30)  # rows of ended sessions


@dataclass(frozen=True, slots=True)
class IssuedSession:
    """A session's token, shown once. The session also ends after `idle_minutes` without use."""

    token: str
    name: str
    is_admin: bool
    expires_at: datetime
    idle_minutes: int


@dataclass(frozen=True, slots=True)
class SessionView:
    """The signed-in staff member and their role by study code."""

    name: str
    is_admin: bool
    roles: dict[str, Role]
    expires_at: datetime


def sign_in(database: Database, passwords: Passwords, name: str, password: str) -> IssuedSession:
    """Open a session. Raises UnauthenticatedError (`sign_in_failed`): unknown name, wrong password or disabled."""
    with database.read() as session:
        candidate = people.find_staff(session, normal_name(name))
    checked_hash = candidate.password_hash if candidate is not None else None
    try:
        verdict = passwords.check(password, checked_hash)
    except InvalidInputError:
        raise _failure() from None
    if candidate is None or candidate.disabled_at is not None or not verdict.is_right:
        raise _failure()
    token, now = new_token(), datetime.now(UTC)
    with database.write() as session:
        staff = people.find_staff(session, candidate.name, lock=True)
        if staff is None or staff.disabled_at is not None or staff.password_hash != checked_hash:
            raise _failure()  # disabled or given another password meanwhile
        if verdict.fresh_hash is not None:
            staff.password_hash = verdict.fresh_hash
        people.delete_sessions(session, staff.id, now - SESSIONS_KEPT)
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
    return IssuedSession(
        token, staff.name, staff.is_admin, now + SESSION_VALID, SESSION_IDLE // MINUTE
    )


def read_session(database: Database, caller: StaffCaller) -> SessionView:
    """Return the signed-in staff member."""
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
    """Change the caller's password and end all their sessions, this one included, and personal tokens.

    Raises UnauthenticatedError (`sign_in_failed`: the current password is wrong), InvalidInputError
    (`password_refused`).
    """
    with database.read() as session:
        checked_hash = session.get_one(Staff, caller.staff_id).password_hash
    if not passwords.check(current, checked_hash).is_right:
        raise _failure()
    if new == current:
        raise InvalidInputError(
            "The new password is the same as the current one.", code="password_refused"
        )
    hashed, now = passwords.hash(new, name=caller.name), datetime.now(UTC)
    with database.write() as session:
        staff = people.find_staff(session, caller.name, lock=True)
        if staff is None or staff.password_hash != checked_hash:
            raise _failure()
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


def _failure() -> UnauthenticatedError:
    return UnauthenticatedError(
        "Name or password are wrong, or the account is disabled.", code="sign_in_failed"
    )
