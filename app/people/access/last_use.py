"""Store when a phone or a token was last used, at most once in five minutes, without delaying the request.

One thread writes; if the database is locked, full or unreachable, the use is not stored and the
request is unaffected.
"""

import contextlib
import threading
import time
import uuid
from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

import structlog
from sqlalchemy.exc import SQLAlchemyError

from app.db.session import Database
from app.people import queries as people
from app.people.access.caller import Caller, DeviceCaller

log = structlog.get_logger()

INTERVAL_SECONDS = 300.0
MAX_REMEMBERED = 10_000  # callers; the use of one that is dropped is only stored again
VERSION_LENGTH = 64
# three centuries; a clock that was reset is within, a larger value is invalid
LARGEST_SKEW_SECONDS = 1e10


class LastUse:
    """The last uses noted by one process."""

    def __init__(self, database: Database, clock: Callable[[], float] = time.monotonic) -> None:
        self._database = database
        self._clock = clock
        self._noted: OrderedDict[uuid.UUID, float] = OrderedDict()
        self._lock = threading.Lock()
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="last-use")

    def note(self, caller: Caller, headers: Mapping[str, str]) -> None:
        """Note a use, unless one of this caller was noted recently. Returns at once.

        headers: of the request; phones send their time in `Date` and the app's version in
        `X-App-Version`.
        """
        key = caller.device_id if isinstance(caller, DeviceCaller) else caller.token_id
        with self._lock:
            seconds = self._clock()
            if seconds - self._noted.get(key, -INTERVAL_SECONDS) < INTERVAL_SECONDS:
                return
            self._noted[key] = seconds
            self._noted.move_to_end(key)
            if len(self._noted) > MAX_REMEMBERED:
                self._noted.popitem(last=False)
        with contextlib.suppress(RuntimeError):  # the server is shutting down: close() was called
            now = datetime.now(UTC)
            skew_seconds = clock_skew_seconds(headers.get("date"), now)
            self._writer.submit(
                self._write, caller, now, skew_seconds, _storable(headers.get("x-app-version"))
            )

    def settle(self) -> None:
        """Wait until all uses noted so far are written or have failed."""
        self._writer.submit(lambda: None).result()

    def close(self) -> None:
        """Finish the current write and drop the rest."""
        self._writer.shutdown(wait=True, cancel_futures=True)

    def _write(
        self, caller: Caller, at: datetime, skew_seconds: float | None, app_version: str | None
    ) -> None:
        try:
            with self._database.write() as session:
                if isinstance(caller, DeviceCaller):
                    people.note_device(session, caller.device_id, at, skew_seconds, app_version)
                else:
                    people.note_token(session, caller.token_id, at)
        except SQLAlchemyError as error:
            log.warning("last_use_not_noted", error=type(error).__name__)


def clock_skew_seconds(date_header: str | None, now: datetime) -> float | None:
    """Return how far a phone's clock is ahead, by the `Date` of its request (RFC 9110, 6.6.1); None: unknown."""
    if date_header is None:
        return None
    try:
        phone_time = parsedate_to_datetime(date_header)
        skew = (phone_time if phone_time.tzinfo else phone_time.replace(tzinfo=UTC)) - now
    except (ValueError, TypeError, OverflowError, IndexError):
        return None
    seconds = round(skew.total_seconds(), 1)
    return seconds if abs(seconds) <= LARGEST_SKEW_SECONDS else None


def _storable(app_version: str | None) -> str | None:
    """Return the header's value if the database can store it, else None."""
    if not app_version or len(app_version) > VERSION_LENGTH or not app_version.isprintable():
        return None
    return app_version
