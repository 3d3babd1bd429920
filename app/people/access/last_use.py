"""When a phone or a token was last used: noted at most once in five minutes, beside the request, never in its way.

One thread writes; a database that is locked, full or away costs the note, not the request.
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

EVERY_SECONDS = 300.0
REMEMBERED = 10_000  # callers of the last minutes; one that is forgotten is only noted again
VERSION_LENGTH = 64
LARGEST_SKEW_SECONDS = 1e10  # three centuries: a clock that was reset lies within; what lies beyond is no clock


class LastUse:
    """Notes of one process."""

    def __init__(self, database: Database, clock: Callable[[], float] = time.monotonic) -> None:
        self._database = database
        self._clock = clock
        self._noted: OrderedDict[uuid.UUID, float] = OrderedDict()
        self._lock = threading.Lock()
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="last-use")

    def note(self, caller: Caller, headers: Mapping[str, str]) -> None:
        """Note a use, unless this caller's was noted a moment ago. Returns at once.

        headers: of the request; phones send their clock in `Date` and the app's version in `X-App-Version`.
        """
        key = caller.device_id if isinstance(caller, DeviceCaller) else caller.token_id
        with self._lock:
            seconds = self._clock()
            if seconds - self._noted.get(key, -EVERY_SECONDS) < EVERY_SECONDS:
                return
            self._noted[key] = seconds
            self._noted.move_to_end(key)
            if len(self._noted) > REMEMBERED:
                self._noted.popitem(last=False)
        with contextlib.suppress(RuntimeError):  # the server is going down: close() was called
            now = datetime.now(UTC)
            skew_seconds = clock_skew_seconds(headers.get("date"), now)
            self._writer.submit(self._write, caller, now, skew_seconds, _storable(headers.get("x-app-version")))

    def settle(self) -> None:
        """Wait until what was noted so far is written, or given up."""
        self._writer.submit(lambda: None).result()

    def close(self) -> None:
        """Finish the note in hand and drop the rest."""
        self._writer.shutdown(wait=True, cancel_futures=True)

    def _write(self, caller: Caller, at: datetime, skew_seconds: float | None, app_version: str | None) -> None:
        try:
            with self._database.write() as session:
                if isinstance(caller, DeviceCaller):
                    people.note_device(session, caller.device_id, at, skew_seconds, app_version)
                else:
                    people.note_token(session, caller.token_id, at)
        except SQLAlchemyError as error:
            log.warning("last_use_not_noted", error=type(error).__name__)


def clock_skew_seconds(date_header: str | None, now: datetime) -> float | None:
    """How far a phone's clock is ahead, by its request's `Date` (RFC 9110, 6.6.1: whole seconds); None: unknown."""
    if date_header is None:
        return None
    try:
        told = parsedate_to_datetime(date_header)
        skew = (told if told.tzinfo else told.replace(tzinfo=UTC)) - now
    except (ValueError, TypeError, OverflowError, IndexError):
        return None
    seconds = round(skew.total_seconds(), 1)
    return seconds if abs(seconds) <= LARGEST_SKEW_SECONDS else None


def _storable(app_version: str | None) -> str | None:
    """A header's value as the database can keep it; what is none of ours is left out."""
    if not app_version or len(app_version) > VERSION_LENGTH or not app_version.isprintable():
        return None
    return app_version
