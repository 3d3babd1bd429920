"""Decide whether the clock can be trusted to erase by age: an erasure cannot be undone.

A row keeps the clock as a worker last saw it; before there is one, the newest event tells when somebody saw the clock.
A clock that is over a day off, also after a pause, is doubted until the workers have run for a day or an operator says
that it is right.
"""

import time
from collections.abc import Callable
from datetime import datetime

import structlog
from sqlalchemy.orm import Session

from app.db.session import Database
from app.metrics import instruments
from app.operations.queries import database_now, last_event_at
from app.people.privacy_queries import locked_deployment

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
            row = locked_deployment(session)
            seen_at = row.clock_at or last_event_at(session) or now
            gap = (now - seen_at).total_seconds()
            if abs(gap) > GAP_SECONDS:
                row.clock_doubted_seconds = WAIT_SECONDS
                log.error("clock_doubted", gap_seconds=round(gap), seen_at=seen_at.isoformat())
            else:
                row.clock_doubted_seconds = max(
                    0.0, row.clock_doubted_seconds - max(0.0, min(gap, ran))
                )
            row.clock_at = now
            is_doubted = row.clock_doubted_seconds > 0
        instruments.CLOCK_DOUBTED.set(is_doubted)
        return None if is_doubted else now


def trust_clock(session: Session) -> None:
    """Trust the clock as it is now."""
    row = locked_deployment(session)
    row.clock_at, row.clock_doubted_seconds = database_now(session), 0.0
