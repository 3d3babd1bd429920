"""Child processes that one test's server after another uses: a start imports OpenCV, SciPy and the app anew, 2 s.

A child that has answered its requests is kept when its pool ends, and the next pool that would start one like it
takes it. Children that failed, were killed or work still end as they do outside of tests.
"""

import os
import queue
import sys
from concurrent.futures import ThreadPoolExecutor

from app.children.child_pool import KEPT_VARIABLES, USES, ChildResult, _Child


class KeptChildren:
    """`start` stands in the place of child_pool._Child."""

    def __init__(self) -> None:
        # the kernel kills children when the thread that started them ends, and pools end theirs with them
        self._starter = ThreadPoolExecutor(1)
        self._idle: dict[object, queue.LifoQueue[KeptChild]] = {}

    def start(self, tasks: str, memory_bytes: int) -> "KeptChild":
        """A child without work, kept or new."""
        # what else of this process a child takes over
        same = (tasks, memory_bytes, *sys.path, *(os.environ.get(name) for name in KEPT_VARIABLES))
        idle = self._idle.setdefault(same, queue.LifoQueue())
        while not idle.empty():
            child = idle.get()
            if child.is_alive():
                return child
            child.end_process()
        return self._starter.submit(KeptChild, tasks, memory_bytes, idle).result()

    def close(self) -> None:
        """End all that are kept."""
        for idle in self._idle.values():
            while not idle.empty():
                idle.get().end_process()
        self._starter.shutdown()


class KeptChild(_Child):
    """A child that is kept without work at the end of its pool."""

    def __init__(self, tasks: str, memory_bytes: int, idle: "queue.LifoQueue[KeptChild]") -> None:
        super().__init__(tasks, memory_bytes)
        self._idle = idle
        self._is_idle = True

    def perform(self, *arguments: object) -> ChildResult | None:
        self._is_idle = False
        result = super().perform(*arguments)
        self._is_idle = result is not None and result.outcome == "ok"
        return result

    def kill(self) -> None:
        self._is_idle = False
        super().kill()

    def end(self) -> None:
        if self._is_idle and self.is_alive() and self.uses < USES:
            self._idle.put(self)
        else:
            self.end_process()

    def end_process(self) -> None:
        super().end()
