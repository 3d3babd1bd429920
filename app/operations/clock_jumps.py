"""Decide whether the wall clock can be trusted for irreversible erasures: not soon after it jumped ahead.

A clock set years ahead by mistake would make every photograph too old; erasing cannot be undone, so it waits.
"""

import time
from collections.abc import Callable

JUMP_SECONDS = 3600.0  # a larger change is not the correction of a drifting clock
WAIT_SECONDS = 86400.0  # a clock that jumped is trusted again after this time; operators can react to the log meanwhile
RUNNING = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # Linux has a clock that continues during suspend


class ClockJumps:
    """Watches one process's clock. wall, running: for tests."""

    def __init__(
        self,
        wall: Callable[[], float] = time.time,
        running: Callable[[], float] = lambda: time.clock_gettime(RUNNING),
    ) -> None:
        self._wall = wall
        self._running = running
        self._ahead = wall() - running()
        self._doubted_since: float | None = None

    def is_steady(self) -> bool:
        """Return whether the clock is trusted. Call often: a jump is detected by the next call, trusted a day later."""
        running = self._running()
        ahead = self._wall() - running
        jumped = ahead - self._ahead
        if abs(jumped) > JUMP_SECONDS:
            self._doubted_since = running if jumped > 0 else None  # a jump back makes nothing too old
        self._ahead = ahead
        if self._doubted_since is not None and running - self._doubted_since >= WAIT_SECONDS:
            self._doubted_since = None
        return self._doubted_since is None
