"""Passwords: what is accepted as one, and Argon2id, bounded so that many sign-ins at once do not fill the memory.

Hashing takes 64 MiB and some ten milliseconds: never inside a write transaction.
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
LEAST_GUESSES = 1e8  # zxcvbn's for what withstands guessing against a slow hash
ESTIMATED_LENGTH = 72  # of a password, whose strength is estimated; takes 25 ms, and grows with its square
AT_ONCE = 2  # hashes at the same time in one process: 128 MiB
WAITING = 16  # who else may wait; each holds a thread of the server
# RFC 9106, section 4, second recommended option: 64 MiB, 3 passes, 4 lanes
MEMORY_KIB, PASSES, LANES = 65536, 3, 4
SALT_BYTES, DIGEST_BYTES, ARGON2_VERSION = 16, 32, 19  # of what the hasher makes; 19: 1.3


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the password was right; fresh_hash: the same password under today's parameters, where they differ."""

    is_right: bool
    fresh_hash: str | None = None


class Passwords:
    """Hashes and checks; one a process, shared by its threads."""

    def __init__(self) -> None:
        self._hasher = _hasher()
        self._running = threading.BoundedSemaphore(AT_ONCE)
        self._admitted = threading.BoundedSemaphore(AT_ONCE + WAITING)
        self._of_nobody = _hash_of_nobody()

    def hash(self, password: str, *, name: str) -> str:
        """The hash of a new password of whoever has this name. Raises InvalidInputError (`password_refused`)."""
        password = _normal(password)
        if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
            raise _refused(f"A password has {MIN_LENGTH} to {MAX_LENGTH} characters.")
        if password.casefold() == _normal(name).casefold():
            raise _refused("A password must not be the name.")
        if _guesses(password, name) < LEAST_GUESSES:
            raise _refused(
                "This password is among the first that are guessed: a few words that do not belong together."
            )
        with self._room():
            return self._hasher.hash(password)

    def check(self, password: str, stored: str | None) -> Verdict:
        """Whether this is the password of a stored hash. None takes as long and is always wrong.

        Raises UnavailableError while too many others wait.
        """
        password = _normal(password)[: MAX_LENGTH + 1]
        with self._room():
            is_right, fresh = self._hasher.verify_and_update(password, stored or self._of_nobody)
        return Verdict(is_right, fresh) if is_right and stored is not None else Verdict(False)

    @contextmanager
    def _room(self) -> Iterator[None]:
        if not self._admitted.acquire(blocking=False):
            raise UnavailableError("Too many people sign in at this moment: try again in a few seconds.")
        try:
            with self._running:
                yield
        finally:
            self._admitted.release()


def _guesses(password: str, name: str) -> float:
    """How many guesses somebody needs who knows common passwords, words, dates, keyboards and the name (zxcvbn)."""
    return float(zxcvbn(password[:ESTIMATED_LENGTH], user_inputs=[name, "tada"])["guesses"])


def _hasher() -> PasswordHash:
    return PasswordHash((Argon2Hasher(time_cost=PASSES, memory_cost=MEMORY_KIB, parallelism=LANES),))


def _hash_of_nobody() -> str:
    """What is checked where there is no hash, so that an unknown name takes as long as a wrong password.

    Drawn, not computed: that would take the memory of a sign-in at every start. No password is known to have it.
    """
    salt, digest = (b64encode(token_bytes(count)).decode().rstrip("=") for count in (SALT_BYTES, DIGEST_BYTES))
    return f"$argon2id$v={ARGON2_VERSION}$m={MEMORY_KIB},t={PASSES},p={LANES}${salt}${digest}"


def _normal(text: str) -> str:
    """The same word typed on another keyboard is the same password (NIST SP 800-63B, 5.1.1.2)."""
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise _refused("A password must not contain half of a character (a lone surrogate).")
    return unicodedata.normalize("NFKC", text)


def _refused(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="password_refused")
