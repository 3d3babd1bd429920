"""Delete the blobs of erasures and orphans.

Blobs of erasures are deleted after another check against the database, orphans after a grace time.
It runs periodically beside the jobs (operations/chores.py). Concurrent runs are harmless: deleting
a blob that does not exist succeeds.
"""

import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import islice

import structlog

from app.db import spent_keys
from app.db.session import Database
from app.jobs.leases import living_workers
from app.metrics import instruments
from app.people import privacy_queries as people_privacy
from app.privacy import queries as privacy
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

BATCH = 200
# then the store is at fault, not a blob, and the rest waits for the next run
MAX_CONSECUTIVE_FAULTS = 3
# far longer than an upload or an estimate takes from sealing to commit
ORPHAN_GRACE = timedelta(hours=24)

SLICE_SECONDS = 10.0


class BlobDeleter:
    """The deletions of one process."""

    def __init__(self, database: Database, blobs: BlobStore) -> None:
        self._database = database
        self._blobs = blobs
        # an earlier process may have left erased rows in SQLite's log
        self._log_may_hold_erased = True

    def delete_scheduled(self) -> int:
        """Delete the blobs that erasures have scheduled.

        Returns the number of deletions carried out.

        Raises OSError if the store does not delete a blob; its deletion stays scheduled and does
        not block the others.
        """
        total = 0
        while True:
            with self._database.read() as session:
                scheduled = people_privacy.scheduled_deletions(session, BATCH)
            if not scheduled:
                break
            deleted, fault = self._delete_all(scheduled)
            with self._database.write() as session:
                people_privacy.remove_scheduled_deletions(session, deleted)
            self._log_may_hold_erased = True
            total += len(deleted)
            if fault is not None:
                raise fault
        if self._log_may_hold_erased and self._database.empty_log():
            self._log_may_hold_erased = False
        return total

    def delete_orphans(self, grace: timedelta = ORPHAN_GRACE) -> int:
        """Run all of `orphan_batches`. Returns the number of blobs deleted."""
        return sum(self.orphan_batches(grace))

    def orphan_batches(self, grace: timedelta = ORPHAN_GRACE) -> Iterator[int]:
        """Delete blobs older than the grace time that no row names; yield the number after each batch of the listing.

        Orphans come from uploads that failed after sealing, workers that continued an erased job,
        and stores restored from a backup. They may belong to a meal whose other blobs are named.
        """
        before, foreign = datetime.now(UTC) - grace, 0
        old = (blob.key for blob in self._blobs.keys() if blob.stored_at < before)  # noqa: SIM118  # not a mapping
        while keys := list(islice(old, BATCH)):
            with self._database.read() as session:
                own = privacy.keys_of_studies(session, keys)
                orphans = sorted(own - privacy.needed_keys(session, own))
            foreign += len(keys) - len(own)
            yield self._delete_orphans(orphans, before)
        if foreign:  # studies are never deleted, so store and database do not belong together
            log.error("blobs_of_no_study", count=foreign)

    def tidy(self) -> None:
        """Remove files that dead processes left in this machine's staging folder."""
        self._blobs.remove_abandoned()

    def _delete_orphans(self, keys: Sequence[str], before: datetime) -> int:
        """Check keys again and delete the orphans: a photograph sent again meanwhile is younger, or has a row.

        The keys are spent in one short transaction before the first blob is deleted, so that a
        process that has just sealed one of them cannot name it (docs/storage.md).
        """
        old = [key for key in keys if self._is_old(key, before)]
        if not old:  # usual: no write transaction, so that other writers need not wait
            return 0
        with self._database.write() as session:
            free = spent_keys.hold_alone(session, old)
            orphans = free - privacy.needed_keys(session, free)
            spent_keys.spend(session, orphans, datetime.now(UTC))
        for key in sorted(orphans):
            self._blobs.delete(key)
            instruments.BLOBS_DELETED.labels("orphan").inc()
        return len(orphans)

    def _is_old(self, key: str, before: datetime) -> bool:
        siblings = self._blobs.keys(key.rpartition("/")[0] + "/")
        return any(blob.key == key and blob.stored_at < before for blob in siblings)

    def _delete_all(self, keys: Sequence[str]) -> tuple[list[str], OSError | None]:
        """Delete blobs. Returns the keys that were deleted and the last fault."""
        deleted: list[str] = []
        fault, consecutive = None, 0
        for key in keys:
            try:
                self._delete(key)
            except OSError as error:
                fault, consecutive = error, consecutive + 1
                if consecutive == MAX_CONSECUTIVE_FAULTS:
                    break
            else:
                deleted.append(key)
                consecutive = 0
        return deleted, fault

    def _delete(self, key: str) -> None:
        with self._database.read() as session:
            if privacy.is_named(session, key):
                log.error("deletion_refused", reason="a row names the blob")
                return
        keys = [blob.key for blob in self._blobs.keys(key)] if key.endswith("/") else [key]
        for blob_key in keys:
            self._blobs.delete(blob_key)
            instruments.BLOBS_DELETED.labels("erased").inc()


@dataclass(frozen=True, slots=True)
class Pace:
    """The interval between rounds, and the delay of the first round after the process started."""

    interval: timedelta
    first_after: timedelta


FILES = Pace(interval=timedelta(hours=1), first_after=timedelta(0))
BUCKET = Pace(interval=timedelta(days=1), first_after=timedelta(hours=1))


class OrphanRounds:
    """Lists the whole store for orphans, a few seconds at a time. clock: seconds; for tests.

    Listing an S3 store takes one call per thousand keys, which costs money, and hours for a hundred
    million keys. So only the oldest living worker does it, on S3 once a day, and not right after it
    started, as a rolling upgrade would begin it again and again. It is done in slices, since
    deliveries and deletions wait for the same thread. The work is not claimed in the database: if
    two workers both consider themselves the oldest, both list, which is harmless.
    """

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
        """Begin a round if it is due and this worker is the oldest, or continue one.

        Returns the orphans deleted.
        """
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
