"""How many exports may be open at once: each holds a copy of its rows or photographs on the disk."""

import threading
import uuid
from collections import Counter
from collections.abc import Callable

from app.core.errors import UnavailableError

OPEN_A_PERSON = 2  # one more than is needed: a download that broke may look open for some minutes
OPEN_AT_ONCE = 8
RETRY_AFTER_SECONDS = 60


class ExportPlaces:
    """How many exports may be open at once in this process: each holds a copy of a person's photographs on the disk."""

    def __init__(self) -> None:
        self._open: Counter[uuid.UUID] = Counter()
        self._lock = threading.Lock()

    def take(self, participant_id: uuid.UUID) -> Callable[[], None]:
        """A place, and how to leave it. Raises UnavailableError (`server_busy`)."""
        with self._lock:
            if self._open[participant_id] >= OPEN_A_PERSON or self._open.total() >= OPEN_AT_ONCE:
                raise UnavailableError(
                    "Other exports are under way: try again in a minute.",
                    code="server_busy",
                    retry_after_seconds=RETRY_AFTER_SECONDS,
                )
            self._open[participant_id] += 1

        def leave() -> None:
            with self._lock:
                self._open[participant_id] -= 1
                self._open = +self._open

        return leave
