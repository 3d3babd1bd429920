"""Codes of an app as the second factor of signing in with a password (TOTP, RFC 6238).

A code is accepted once. After a wrong one none is accepted for the rest of its time step, so that a
person's codes can be guessed at twice a minute, from however many addresses.
"""

import base64
import hmac
import secrets
from collections.abc import Iterable
from datetime import UTC, datetime

from cryptography.hazmat.primitives.hashes import SHA1
from cryptography.hazmat.primitives.twofactor.totp import TOTP

from app.core.errors import ConflictError, InvalidInputError
from app.db.session import Database
from app.people.access.audit import note
from app.people.access.caller import StaffCaller
from app.people.access.secret_box import SecretBox
from app.people.models import Staff

# what apps assume when they are told nothing else (RFC 6238; RFC 4226, section 4)
SECRET_BYTES, DIGITS, STEP_SECONDS = 20, 6, 30
BASE32 = r"[A-Z2-7]{32}"  # a secret
WRONG = "This code is wrong, or was used before: wait for the next one that the app shows."


def new_secret() -> str:
    """Draw a secret, in base32."""
    return base64.b32encode(secrets.token_bytes(SECRET_BYTES)).decode()


def setup_uri(secret: str, *, name: str, server: str) -> str:
    """Return the text of the QR code that an app reads. name, server: as the app lists the account."""
    return _totp(secret).get_provisioning_uri(name, server)


def use_code(box: SecretBox, staff: Staff, code: str, now: datetime) -> bool:
    """Return whether the code is right and may be used; it is used up then.

    staff: locked by the caller, with codes turned on; to be committed in either case.
    """
    step = _step(now)
    if staff.totp_wrong_step == step:
        return False
    steps = range(max(step - 1, (staff.totp_step or 0) + 1), step + 2)
    matched = _matching_step(box.open(staff.totp_secret or ""), code, steps)
    if matched is None:
        staff.totp_wrong_step = step
        return False
    staff.totp_step = matched
    return True


def turn_on(
    database: Database, box: SecretBox, caller: StaffCaller, secret: str, code: str
) -> None:
    """Ask the caller for codes of this secret from now on. code: the proof that their app has it.

    Raises InvalidInputError, ConflictError if they have codes already.
    """
    step = _step(datetime.now(UTC))
    matched = _matching_step(secret, code, range(step - 1, step + 2))
    if matched is None:
        raise InvalidInputError(WRONG)
    with database.write() as session:
        staff = session.get_one(Staff, caller.staff_id, with_for_update=True)
        if staff.has_totp:
            raise ConflictError("Turn your present codes off first.")
        staff.totp_secret, staff.totp_step = box.seal(secret), matched
        note(session, caller, "staff.totp", subject=staff.name, is_on=True)


def turn_off(database: Database, box: SecretBox, caller: StaffCaller, code: str) -> None:
    """Ask the caller, whose password was checked, for no more codes.

    Raises InvalidInputError.
    """
    with database.write() as session:
        staff = session.get_one(Staff, caller.staff_id, with_for_update=True)
        is_right = not staff.has_totp or use_code(box, staff, code, datetime.now(UTC))
        if is_right:
            staff.totp_secret = None
            note(session, caller, "staff.totp", subject=staff.name, is_on=False)
    if not is_right:
        raise InvalidInputError(WRONG)


def _matching_step(secret: str, code: str, steps: Iterable[int]) -> int | None:
    totp, entered = _totp(secret), "".join(code.split()).encode()
    for step in steps:
        if hmac.compare_digest(totp.generate(step * STEP_SECONDS), entered):
            return step
    return None


def _totp(secret: str) -> TOTP:
    return TOTP(base64.b32decode(secret), DIGITS, SHA1(), STEP_SECONDS)  # noqa: S303  # as apps have it; HMAC is sound


def _step(now: datetime) -> int:
    return int(now.timestamp()) // STEP_SECONDS
