"""Delete the blobs of erasures, after another check against the database, and orphans after a grace time.

It runs periodically beside the jobs (operations/chores.py). Concurrent runs are harmless: deleting a blob that does not
exist succeeds.
"""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from itertools import islice

import structlog

from app.db import spent_keys
from app.db.session import Database
from app.metrics import instruments
from app.people import privacy_queries as people_privacy
from app.privacy import queries as privacy
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

BATCH = 200
# then the store is at fault, not a blob, and the rest waits for the next run
MAX_CONSECUTIVE_FAULTS = 3
ORPHAN_GRACE = timedelta(
    hours=24
)  # far longer than an upload or an estimate takes from sealing to commit


class BlobDeleter:
    """The deletions of one process."""

    def __init__(self, database: Database, blobs: BlobStore) -> None:
        self._database = database
        self._blobs = blobs
        # an earlier process may have left erased rows in SQLite's log
        self._log_may_hold_erased = True

    def delete_scheduled(self) -> int:
        """Delete the blobs that erasures have scheduled. Returns the number of deletions carried out.

        Raises OSError if the store does not delete a blob; its deletion stays scheduled and does not block the others.
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

        Orphans come from uploads that failed after sealing, workers that continued an erased job, and stores restored
        from a backup. They may belong to a meal whose other blobs are named.
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

        The keys are spent in one short transaction before the first blob is deleted, so that a process that has just
        sealed one of them cannot name it (docs/storage.md).
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
