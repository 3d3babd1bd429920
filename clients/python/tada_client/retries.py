"""The repeats of a failed attempt: exponential backoff with full jitter, and `Retry-After`."""

import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from email.utils import parsedate_to_datetime

from tada_client.errors import TRANSIENT, NetworkError, Problem


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """The number of attempts, and the pauses between them.

    first_seconds: upper bound of the first pause; it doubles with each attempt, up to longest_seconds. If `Retry-After`
    is longer than longest_seconds, the call fails at once. random: from 0 to 1.
    """

    attempts: int = 6
    first_seconds: float = 0.5
    longest_seconds: float = 60.0
    random: Callable[[], float] = random.random

    def seconds_until_next(self, error: Problem | NetworkError, attempt: int) -> float | None:
        """Seconds until the attempt after this one; None: do not repeat. attempt: from 1."""
        if attempt >= self.attempts or not is_transient(error):
            return None
        jitter = self.random() * min(
            self.longest_seconds, self.first_seconds * 2.0 ** (attempt - 1)
        )
        asked = error.retry_after_seconds if isinstance(error, Problem) else None
        if asked is None:
            return jitter
        return (
            asked + jitter if asked <= self.longest_seconds else None
        )  # not all clients at the same moment


def is_transient(error: Problem | NetworkError) -> bool:
    """Return true if the same request may succeed in a moment; `retryable` of the document decides over the status."""
    return isinstance(error, NetworkError) or (error.retryable and error.status in TRANSIENT)


def retry_after_seconds(headers: Mapping[str, str], now: float | None = None) -> float | None:
    """Seconds that `Retry-After` asks for: a number of them, or a date (RFC 9110, section 10.2.3).

    None: absent or unreadable. A date is compared with the answer's own `Date`: this computer's clock may be wrong.
    """
    value = headers.get("Retry-After", "").strip()
    if value.isascii() and value.isdigit():
        return float(value)
    until = _timestamp(value)
    if until is None:
        return None
    sent = _timestamp(headers.get("Date", ""))
    return max(0.0, until - (sent if sent is not None else now if now is not None else time.time()))


def _timestamp(text: str) -> float | None:
    try:
        return parsedate_to_datetime(text).timestamp() if text.endswith("GMT") else None
    except ValueError:
        return None
