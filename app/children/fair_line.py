"""Queue fairly for a few places: studies take turns, and each caller has one place at a time.

`with line.place(study, caller):` waits for a place. The next place goes to the study that was served least recently,
and within it to the request that came first; a caller who holds a place waits until it is free again. Costly work never
occupies all places, unless there is only one.
"""

import itertools
import threading
import time
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

MAX_STUDIES = 10_000  # the most whose last turns are remembered


class LineFullError(Exception):
    """Too many requests are waiting, or this one has waited too long."""


@dataclass(eq=False, slots=True)
class _Waiting:
    study: Hashable
    caller: Hashable
    number: int  # in the order of arrival
    is_costly: bool


class FairLine:
    """A queue. most_waiting: in total; at most three quarters of them from one study, and half from one caller."""

    def __init__(self, places: int, *, most_waiting: int, wait_seconds: float) -> None:
        self._free = places
        self._free_for_costly = max(1, places - 1)
        self._most_waiting = most_waiting
        self._wait_seconds = wait_seconds
        self._changed = threading.Condition()
        self._waiting: list[_Waiting] = []
        self._served: set[Hashable] = set()  # callers that hold a place
        self._last_turns: dict[Hashable, int] = {}  # by study, the oldest first
        self._numbers = itertools.count()

    @contextmanager
    def place(self, study: Hashable, caller: Hashable, *, is_costly: bool = False) -> Iterator[None]:
        """Wait for a place and hold it. is_costly: the work takes long. Raises LineFullError."""
        self._wait_for(_Waiting(study, caller, next(self._numbers), is_costly))
        try:
            yield
        finally:
            with self._changed:
                self._free += 1
                self._free_for_costly += is_costly
                self._served.discard(caller)
                self._changed.notify_all()

    def _wait_for(self, request: _Waiting) -> None:
        deadline = time.monotonic() + self._wait_seconds
        with self._changed:
            if self._is_full_for(request):
                raise LineFullError
            self._waiting.append(request)
            try:
                while self._next() is not request:
                    remaining = deadline - time.monotonic()
                    if remaining <= 0 or not self._changed.wait(remaining):
                        raise LineFullError
                self._free -= 1
                self._free_for_costly -= request.is_costly
                self._served.add(request.caller)
                self._note_turn(request)
            finally:
                self._waiting.remove(request)
                self._changed.notify_all()

    def _is_full_for(self, request: _Waiting) -> bool:
        """Whether too many requests wait in total, from the study or from the caller."""
        of_study = sum(each.study == request.study for each in self._waiting)
        of_caller = sum(each.caller == request.caller for each in self._waiting)
        most = self._most_waiting
        return len(self._waiting) >= most or of_study >= most - most // 4 or of_caller >= most - most // 2

    def _next(self) -> _Waiting | None:
        """Return the request whose turn it is; None while no place is free for any."""
        if self._free == 0:
            return None
        ready = [
            each
            for each in self._waiting
            if each.caller not in self._served and not (each.is_costly and self._free_for_costly == 0)
        ]
        return min(ready, key=lambda each: (self._last_turns.get(each.study, -1), each.number), default=None)

    def _note_turn(self, served: _Waiting) -> None:
        self._last_turns.pop(served.study, None)
        self._last_turns[served.study] = next(self._numbers)
        if len(self._last_turns) > MAX_STUDIES:
            del self._last_turns[next(iter(self._last_turns))]
