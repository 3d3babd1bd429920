"""The stages of a run by name: told when each begins, and timed."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Stages:
    """Reports each stage when it begins for the first time; keeps how long it took, seconds."""

    def __init__(self, on_stage: Callable[[str], None] = lambda _: None) -> None:
        self.seconds: dict[str, float] = {}
        self._on_stage = on_stage

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time a stage, which may be entered again."""
        if name not in self.seconds:  # a plaque's scene is reconstructed again
            self._on_stage(name)
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started
