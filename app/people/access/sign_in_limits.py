"""How often somebody may try to sign in: by name and address, so that nobody locks another person's name out."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from app.core.errors import RateLimitedError, UnauthenticatedError
from app.http.rate_limit import RateLimit
from app.metrics import instruments
from app.people.access.staff import normal_name

OF_ADDRESS = 3  # times the limit of a name from an address: a clinic is one address
OF_NAME = 10  # times it, from everywhere: what many addresses together may guess
MAX_USUAL = 10_000  # places from which somebody signed in


class SignInLimits:
    """Buckets of this process. per_minute: tries of one name from one address.

    A name's limit over all addresses does not count where that person signed in before: a crowd that guesses keeps them
    out of new places only.
    """

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._of_both = RateLimit(per_minute, clock)
        self._of_address = RateLimit(OF_ADDRESS * per_minute, clock)
        self._of_name = RateLimit(OF_NAME * per_minute, clock)
        self._usual: OrderedDict[str, None] = OrderedDict()
        self._lock = threading.Lock()

    @contextmanager
    def trying(self, name: str, address: str) -> Iterator[None]:
        """Count one try, and how it ends. Raises RateLimitedError."""
        both = f"{address} {normal_name(name)}"
        with self._lock:
            is_usual = both in self._usual
        try:
            self._of_both.take(both)
            self._of_address.take(address)
            if not is_usual:
                self._of_name.take(normal_name(name))
        except RateLimitedError:
            instruments.SIGN_INS.labels("limited").inc()
            raise
        try:
            yield
        except UnauthenticatedError:
            instruments.SIGN_INS.labels("failed").inc()
            raise
        instruments.SIGN_INS.labels("ok").inc()
        with self._lock:
            self._usual[both] = None
            self._usual.move_to_end(both)
            if len(self._usual) > MAX_USUAL:
                self._usual.popitem(last=False)
