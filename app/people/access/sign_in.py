"""Staff sign in with name, password and perhaps a code, sign out, and change their password.

All refusals of names and passwords look and take the same. Attempts are limited by name and
address, so that an attacker cannot lock out another person's name; the database counts them for all
processes and hosts.
"""

import math
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError, RateLimitedError, UnauthenticatedError
from app.db.session import Database
from app.http.rate_limit import too_many_calls
from app.metrics import instruments
from app.people import queries as people
from app.people.access.access_tokens import EndedAccess, end_access
from app.people.access.audit import note
from app.people.access.caller import SESSION_IDLE, StaffCaller, new_token, sha256_hex
from app.people.access.passwords import Passwords
from app.people.access.secret_box import SecretBox
from app.people.access.staff import normal_name
from app.people.access.staff_schemas import SessionIssued, SessionOut
from app.people.access.totp import WRONG, use_code
from app.people.models import AccessToken, SignInAttempt, Staff

MINUTE = timedelta(minutes=1)
SESSION_VALID = timedelta(hours=12)  # a working day
SESSIONS_KEPT = timedelta(days=30)  # rows of ended sessions
# attempts from one address, as a multiple of those of one name: a clinic is one address
ADDRESS_FACTOR = 3
NAME_FACTOR = 10  # attempts of one name from all addresses, as the same multiple
WINDOW = timedelta(minutes=1)
PROOF_SECONDS = 300  # for entering the code after the password
FAILURES_KEPT, SUCCESSES_KEPT = timedelta(hours=1), timedelta(days=90)
# of PostgreSQL, that attempts are counted one after the other: any number of our own
LOCK = 7_346_210_988


def sign_in(
    database: Database,
    box: SecretBox,
    passwords: Passwords,
    name: str,
    password: str,
    code: str = "",
) -> SessionIssued:
    """Open a session.

    Raises UnauthenticatedError: `sign_in_failed` for an unknown name, a wrong password or a disabled
    account; `code_needed` if only the code is missing or wrong.
    """
    checked_hash = check_password(database, passwords, name, password)
    return open_session(database, box, name, checked_hash, code)


def check_password(database: Database, passwords: Passwords, name: str, password: str) -> str:
    """Return the hash of a right password, by which `open_session` notices a change.

    Raises UnauthenticatedError (`sign_in_failed`).
    """
    with database.read() as session:
        candidate = people.find_staff(session, normal_name(name))
    checked_hash = candidate.password_hash if candidate is not None else None
    try:
        verdict = passwords.check(password, checked_hash)
    except InvalidInputError:
        raise _failure() from None
    if (
        candidate is None
        or checked_hash is None
        or candidate.disabled_at is not None
        or not verdict.is_right
    ):
        raise _failure()
    if verdict.fresh_hash is None:
        return checked_hash
    with database.write() as session:
        staff = session.get_one(Staff, candidate.id, with_for_update=True)
        if staff.password_hash == checked_hash:
            staff.password_hash = verdict.fresh_hash
    return verdict.fresh_hash


def open_session(
    database: Database, box: SecretBox, name: str, checked_hash: str, code: str
) -> SessionIssued:
    """Open a session of a person whose password was right. Raises UnauthenticatedError as `sign_in` does."""
    now = datetime.now(UTC)
    with database.write() as session:
        staff = people.find_staff(session, normal_name(name), lock=True)
        if staff is None or staff.disabled_at is not None or staff.password_hash != checked_hash:
            raise _failure()  # disabled or given another password meanwhile
        if staff.has_totp and not code:
            raise UnauthenticatedError("Enter the code that your app shows.", code="code_needed")
        if not staff.has_totp or use_code(box, staff, code, now):
            return add_session(session, staff, now)
    raise UnauthenticatedError(WRONG, code="code_needed")  # after the commit


def open_proof(box: SecretBox, proof: str) -> str:
    """Return the checked hash that was sealed in the page that asks for the code.

    Raises UnauthenticatedError (`sign_in_failed`).
    """
    checked_hash = box.open_recent(proof, PROOF_SECONDS)
    if checked_hash is None:
        raise UnauthenticatedError(
            "That took too long: enter your password again.", code="sign_in_failed"
        )
    return checked_hash


def add_session(
    session: Session, staff: Staff, now: datetime, by: str = "password"
) -> SessionIssued:
    """Open a session of a person who has proved who they are."""
    token = new_token()
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
    caller = StaffCaller(staff.id, staff.name, staff.is_admin, row.id)
    note(session, caller, "session.open", by=by)
    return SessionIssued(
        token=token,
        name=staff.name,
        is_admin=staff.is_admin,
        expires_at=now + SESSION_VALID,
        idle_minutes=SESSION_IDLE // MINUTE,
    )


def read_session(database: Database, caller: StaffCaller) -> SessionOut:
    """Return the signed-in staff member."""
    with database.read() as session:
        codes = people.codes_of_studies(session, caller.roles.keys())
        row = session.get_one(AccessToken, caller.token_id)
    roles = {codes[study]: role for study, role in caller.roles.items() if study in codes}
    expires_at = row.expires_at or datetime.now(UTC) + SESSION_VALID
    return SessionOut(
        name=caller.name,
        is_admin=caller.is_admin,
        roles=dict(sorted(roles.items())),
        expires_at=expires_at,
    )


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
        ended = end_access(session, staff, now)
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


class SignInLimits:
    """per_minute: attempts of one name from one address.

    A name's limit over all addresses does not apply to addresses from which that person has signed
    in before, so a distributed attack keeps them out at new addresses only.
    """

    def __init__(self, database: Database, box: SecretBox, per_minute: int) -> None:
        self._database = database
        self._box = box
        self._per_minute = per_minute

    @contextmanager
    def trying(self, name: str, address: str) -> Iterator[None]:
        """Count an attempt and its outcome. Raises RateLimitedError."""
        attempt_id = uuid.uuid4()
        try:
            with self._database.write() as session:
                attempt = SignInAttempt(
                    id=attempt_id,
                    name_digest=self._box.digest("sign-in name", normal_name(name)),
                    address_digest=self._box.digest("sign-in address", address),
                    attempted_at=datetime.now(UTC),
                )
                self._require_room(session, attempt)
                session.add(attempt)
        except RateLimitedError:
            instruments.SIGN_INS.labels("limited").inc()
            raise
        try:
            yield
        except UnauthenticatedError:
            instruments.SIGN_INS.labels("failed").inc()
            raise
        instruments.SIGN_INS.labels("ok").inc()
        with self._database.write() as session:
            session.execute(
                sa.update(SignInAttempt)
                .where(SignInAttempt.id == attempt_id)
                .values(is_success=True)
            )

    def _require_room(self, session: Session, attempt: SignInAttempt) -> None:
        if session.get_bind().dialect.name == "postgresql":
            session.execute(sa.select(sa.func.pg_advisory_xact_lock(LOCK)))
        of_name = SignInAttempt.name_digest == attempt.name_digest
        of_address = SignInAttempt.address_digest == attempt.address_digest
        is_usual = session.scalar(
            sa.select(sa.exists().where(of_name, of_address, SignInAttempt.is_success))
        )
        limits = [
            (sa.and_(of_name, of_address), self._per_minute),
            (of_address, ADDRESS_FACTOR * self._per_minute),
        ]
        if not is_usual:
            limits.append((of_name, NAME_FACTOR * self._per_minute))
        for condition, most in limits:
            self._require_fewer(session, condition, most, attempt.attempted_at)

    def _require_fewer(
        self, session: Session, condition: sa.ColumnElement[bool], most: int, now: datetime
    ) -> None:
        """Raise RateLimitedError if the last minute has so many attempts."""
        query = sa.select(sa.func.count(), sa.func.min(SignInAttempt.attempted_at)).where(
            condition, SignInAttempt.attempted_at > now - WINDOW
        )
        count, first_at = session.execute(query).one()
        if count >= most:
            raise too_many_calls(math.ceil((first_at + WINDOW - now).total_seconds()), most)


def forget_attempts(database: Database) -> None:
    """Remove attempts that no longer count."""
    now = datetime.now(UTC)
    is_old = SignInAttempt.attempted_at < now - FAILURES_KEPT
    is_very_old = SignInAttempt.attempted_at < now - SUCCESSES_KEPT
    with database.write() as session:
        session.execute(
            sa.delete(SignInAttempt).where(
                sa.or_(is_very_old, sa.and_(is_old, sa.not_(SignInAttempt.is_success)))
            )
        )
