"""Decide whether the clock can be trusted to erase by age: an erasure cannot be undone.

A row keeps the clock as a worker last saw it. A clock that is over a day off that row is doubted until the workers have
run for a day, or an operator says that it is right. So is a clock after a pause of over a day.
"""

import time
from collections.abc import Callable
from datetime import datetime

import structlog
from sqlalchemy.orm import Session

from app.db.session import Database
from app.metrics import instruments
from app.operations import doctor_queries
from app.operations.figure_queries import database_now
from app.people.privacy_models import SEEN_CLOCK, SeenClock

log = structlog.get_logger()

GAP_SECONDS = 86400.0
WAIT_SECONDS = 86400.0


class TrustedClock:
    """The clock of the database; on SQLite this machine's. running: seconds by a clock that nobody sets; for tests."""

    def __init__(self, database: Database, running: Callable[[], float] = time.monotonic) -> None:
        self._database = database
        self._running = running
        self._last_tick: float | None = None

    def tick(self) -> datetime | None:
        """Compare the clock with the row, then write it there. Returns the time, None while it is doubted."""
        running = self._running()
        ran = 0.0 if self._last_tick is None else running - self._last_tick
        self._last_tick = running
        with self._database.write() as session:
            now = database_now(session)
            seen = _seen_clock(session, now)
            gap = (now - seen.at).total_seconds()
            if abs(gap) > GAP_SECONDS:
                seen.doubted_seconds = WAIT_SECONDS
                log.error("clock_doubted", gap_seconds=round(gap), seen_at=seen.at.isoformat())
            else:
                seen.doubted_seconds = max(0.0, seen.doubted_seconds - max(0.0, min(gap, ran)))
            seen.at = now
            is_doubted = seen.doubted_seconds > 0
        instruments.CLOCK_DOUBTED.set(is_doubted)
        return None if is_doubted else now


def doubted_seconds(session: Session) -> float:
    """Return how long the workers must still run until the clock is trusted; 0: it is trusted."""
    seen = session.get(SeenClock, SEEN_CLOCK)
    return 0.0 if seen is None else seen.doubted_seconds


def trust_clock(session: Session) -> datetime:
    """Trust the clock as it is now, and return it."""
    now = database_now(session)
    seen = _seen_clock(session, now)
    seen.at, seen.doubted_seconds = now, 0.0
    return now


def _seen_clock(session: Session, now: datetime) -> SeenClock:
    """Return the locked row; where there is none yet, the newest event tells the time when somebody saw the clock."""
    seen = session.get(SeenClock, SEEN_CLOCK, with_for_update=True)
    if seen is None:
        seen = SeenClock(id=SEEN_CLOCK, at=doctor_queries.last_event_at(session) or now, doubted_seconds=0.0)
        session.add(seen)
    return seen
