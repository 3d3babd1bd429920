"""When the whole store is listed for orphans, and by whom: by the oldest living worker, a little at a time.

A listing asks an S3 store for every thousand keys: money, and hours for a hundred million. So it is not each worker's
work, on S3 it is done once a day, not by a worker that has just started (a rolling upgrade would begin it again and
again), and a round under way goes on for some seconds at a time, since deliveries and deletions wait for the same
thread. Nobody claims the work in the database: should two workers take themselves for the oldest, both list, and a
deletion that finds nothing is one that is done.
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
    """How often a round begins, and how long after this process's start the first one."""

    every: timedelta
    first_after: timedelta


FILES = Pace(every=timedelta(hours=1), first_after=timedelta(0))
BUCKET = Pace(every=timedelta(days=1), first_after=timedelta(hours=1))


class OrphanRounds:
    """The rounds of one worker. clock: seconds, another in tests."""

    def __init__(
        self, database: Database, deleter: BlobDeleter, pace: Pace, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._database = database
        self._deleter = deleter
        self._every_seconds = pace.every.total_seconds()
        self._clock = clock
        self._due = clock() + pace.first_after.total_seconds()
        self._round: Iterator[int] | None = None

    def go_on(self) -> int:
        """Begin a round if it is due and ours, or go on with one for a while. Returns how many orphans went."""
        if self._round is None:
            if self._clock() < self._due or not self._is_ours():
                return 0
            self._due = self._clock() + self._every_seconds
            self._round = self._deleter.orphan_batches()
        until, done = self._clock() + SLICE_SECONDS, 0
        try:
            for deleted in self._round:
                done += deleted
                if self._clock() >= until:
                    return done
        except BaseException:
            self._round = None  # the next one begins at the beginning
            raise
        self._round = None
        log.info("orphan_round_ended")
        return done

    def _is_ours(self) -> bool:
        alive = living_workers(self._database)
        return not alive or (alive[0].host, alive[0].pid) == (socket.gethostname(), os.getpid())
