"""Limits of sign-in attempts by name and address, so that an attacker cannot lock out another person's name."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from app.core.errors import RateLimitedError, UnauthenticatedError
from app.http.rate_limit import RateLimit
from app.http.shared_memory import KeyTable
from app.metrics import instruments
from app.people.access.staff import normal_name

ADDRESS_FACTOR = 3  # attempts from one address, as a multiple of those of one name from it: a clinic is one address
NAME_FACTOR = 10  # attempts of one name from all addresses, as the same multiple


class SignInLimits:
    """Rate limits of a server's processes together. per_minute: attempts of one name from one address.

    A name's limit over all addresses does not apply to addresses from which that person has signed in before, so a
    distributed attack keeps them out at new addresses only.
    """

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._by_pair = RateLimit(per_minute, clock)
        self._by_address = RateLimit(ADDRESS_FACTOR * per_minute, clock)
        self._by_name = RateLimit(NAME_FACTOR * per_minute, clock)
        self._usual = KeyTable()  # pairs of address and name that have signed in
        self._clock = clock

    @contextmanager
    def trying(self, name: str, address: str) -> Iterator[None]:
        """Count an attempt and its outcome. Raises RateLimitedError."""
        pair = f"{address} {normal_name(name)}"
        with self._usual.lock:
            is_usual = self._usual.get(pair) is not None
        try:
            self._by_pair.take(pair)
            self._by_address.take(address)
            if not is_usual:
                self._by_name.take(normal_name(name))
        except RateLimitedError:
            instruments.SIGN_INS.labels("limited").inc()
            raise
        try:
            yield
        except UnauthenticatedError:
            instruments.SIGN_INS.labels("failed").inc()
            raise
        instruments.SIGN_INS.labels("ok").inc()
        with self._usual.lock:
            self._usual.put(pair, 1.0, self._clock())
