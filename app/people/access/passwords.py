"""Check passwords and hash them with Argon2id, a bounded number at a time so that sign-ins do not exhaust memory.

Hashing takes 64 MiB and tens of milliseconds: never do it inside a write transaction.
"""

import threading
import unicodedata
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from secrets import token_bytes

from pwdlib import PasswordHash
from pwdlib.hashers.argon2 import Argon2Hasher
from zxcvbn import zxcvbn

from app.core.errors import InvalidInputError, UnavailableError

MIN_LENGTH = 12
MAX_LENGTH = 200  # a passphrase fits; a megabyte to hash does not
LEAST_GUESSES = 1e8  # zxcvbn's threshold for resisting guesses against a slow hash
# characters whose strength is estimated; takes 25 ms and grows with the square of the length
ESTIMATED_LENGTH = 72
MAX_CONCURRENT = 2  # hashes at the same time in one process: 128 MiB
MAX_WAITING = 16  # further callers; each holds a thread of the server
# RFC 9106, section 4, second recommended option: 64 MiB, 3 passes, 4 lanes
MEMORY_KIB, PASSES, LANES = 65536, 3, 4
SALT_BYTES, DIGEST_BYTES, ARGON2_VERSION = 16, 32, 19  # of the hasher's hashes; 19 is version 1.3


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the password was right.

    fresh_hash: its hash with current parameters, if the stored one has others.
    """

    is_right: bool
    fresh_hash: str | None = None


class Passwords:
    """Hashes and checks passwords; one per process, shared by its threads."""

    def __init__(self) -> None:
        self._hasher = _hasher()
        self._running = threading.BoundedSemaphore(MAX_CONCURRENT)
        self._admitted = threading.BoundedSemaphore(MAX_CONCURRENT + MAX_WAITING)
        self._dummy_hash = _random_hash()

    def hash(self, password: str, *, name: str) -> str:
        """Check and hash a new password of the staff member `name`.

        Raises InvalidInputError (`password_refused`).
        """
        password = _normalise(password)
        if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
            raise _refusal(f"A password has {MIN_LENGTH} to {MAX_LENGTH} characters.")
        if password.casefold() == _normalise(name).casefold():
            raise _refusal("A password must not be the name.")
        if _count_guesses(password, name) < LEAST_GUESSES:
            raise _refusal(
                "This password is easy to guess: use a few words that do not belong together."
            )
        with self._slot():
            return self._hasher.hash(password)

    def check(self, password: str, stored: str | None) -> Verdict:
        """Check a password against a stored hash. stored None: takes as long and is always wrong.

        Raises UnavailableError if too many others wait.
        """
        password = _normalise(password)[: MAX_LENGTH + 1]
        with self._slot():
            is_right, fresh_hash = self._hasher.verify_and_update(
                password, stored or self._dummy_hash
            )
        return Verdict(is_right, fresh_hash) if is_right and stored is not None else Verdict(False)

    @contextmanager
    def _slot(self) -> Iterator[None]:
        if not self._admitted.acquire(blocking=False):
            raise UnavailableError("Too many people are signing in: try again in a few seconds.")
        try:
            with self._running:
                yield
        finally:
            self._admitted.release()


def _count_guesses(password: str, name: str) -> float:
    """Estimate the guesses needed, given common passwords, words, dates, keyboard patterns and the name (zxcvbn)."""
    return float(zxcvbn(password[:ESTIMATED_LENGTH], user_inputs=[name, "tada"])["guesses"])


def _hasher() -> PasswordHash:
    return PasswordHash(
        (Argon2Hasher(time_cost=PASSES, memory_cost=MEMORY_KIB, parallelism=LANES),)
    )


def _random_hash() -> str:
    """Return a hash to check when there is none, so that an unknown name takes as long as a wrong password.

    It is drawn at random: computing one would take the memory of a sign-in at every start. No known
    password matches.
    """
    salt, digest = (
        b64encode(token_bytes(count)).decode().rstrip("=") for count in (SALT_BYTES, DIGEST_BYTES)
    )
    return f"$argon2id$v={ARGON2_VERSION}$m={MEMORY_KIB},t={PASSES},p={LANES}${salt}${digest}"


def _normalise(text: str) -> str:
    """Normalise Unicode, so that a password is the same on all keyboards (NIST SP 800-63B, 5.1.1.2)."""
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise _refusal("A password must not contain half of a character (a lone surrogate).")
    return unicodedata.normalize("NFKC", text)


def _refusal(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="password_refused")
