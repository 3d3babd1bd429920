"""Schedule the listing of the whole store for orphans: the oldest living worker does it, a few seconds at a time.

Listing an S3 store takes one call per thousand keys, which costs money, and hours for a hundred million keys. So only
one worker does it, on S3 once a day, and not right after it started, as a rolling upgrade would begin it again and
again. It is done in slices, since deliveries and deletions wait for the same thread. The work is not claimed in the
database: if two workers both consider themselves the oldest, both list, which is harmless.
"""

import os
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta

import structlog

from app.db.session import Database
from app.jobs.leases import living_workers
from app.privacy.delete_blobs import BlobDeleter

log = structlog.get_logger()

SLICE_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class Pace:
    """The interval between rounds, and the delay of the first round after the process started."""

    interval: timedelta
    first_after: timedelta


FILES = Pace(interval=timedelta(hours=1), first_after=timedelta(0))
BUCKET = Pace(interval=timedelta(days=1), first_after=timedelta(hours=1))


class OrphanRounds:
    """The rounds of one worker. clock: seconds; replaced in tests."""

    def __init__(
        self,
        database: Database,
        deleter: BlobDeleter,
        pace: Pace,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = database
        self._deleter = deleter
        self._interval_seconds = pace.interval.total_seconds()
        self._clock = clock
        self._due = clock() + pace.first_after.total_seconds()
        self._round: Iterator[int] | None = None

    def run_slice(self) -> int:
        """Begin a round if it is due and this worker is the oldest, or continue one. Returns the orphans deleted."""
        if self._round is None:
            if self._clock() < self._due or not self._is_oldest_worker():
                return 0
            self._due = self._clock() + self._interval_seconds
            self._round = self._deleter.orphan_batches()
        until, total = self._clock() + SLICE_SECONDS, 0
        try:
            for deleted in self._round:
                total += deleted
                if self._clock() >= until:
                    return total
        except BaseException:
            self._round = None  # the next round starts from the beginning
            raise
        self._round = None
        log.info("orphan_round_ended")
        return total

    def _is_oldest_worker(self) -> bool:
        alive = living_workers(self._database)
        return not alive or (alive[0].host, alive[0].pid) == (socket.gethostname(), os.getpid())
