"""Whether the wall clock may be believed by work that erases for good: not soon after it jumped ahead.

A clock that was set years ahead by mistake makes every photograph too old; erasing cannot be taken back, waiting can.
"""

import time
from collections.abc import Callable

JUMP_SECONDS = 3600.0  # more than this is no correction of a drifting clock
WAIT_SECONDS = 86400.0  # so long a clock that jumped must go on as it is; somebody sees the log meanwhile
RUNNING = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # Linux has one that goes on while it is suspended


class ClockJumps:
    """Watches one process's clock. wall, running: others in tests."""

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
        """Ask often: a jump is seen at the next question, and believed a day after it."""
        running = self._running()
        ahead = self._wall() - running
        jumped = ahead - self._ahead
        if abs(jumped) > JUMP_SECONDS:
            self._doubted_since = running if jumped > 0 else None  # back: nothing becomes too old by it
        self._ahead = ahead
        if self._doubted_since is not None and running - self._doubted_since >= WAIT_SECONDS:
            self._doubted_since = None
        return self._doubted_since is None
