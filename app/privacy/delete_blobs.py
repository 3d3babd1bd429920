"""Blobs that an erasure wants gone are deleted, checked once more against the database; orphans go past a grace time.

Run again and again beside the jobs (operations/chores.py). Two at once do no harm: a deletion that finds nothing is one
that is done.
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
FAULTS_IN_A_ROW = 3  # then it is the store and not a blob: it is asked again later
ORPHAN_GRACE = timedelta(hours=24)  # an upload or an estimate that seals first and commits later is long done by then


class BlobDeleter:
    """The chores of one process."""

    def __init__(self, database: Database, blobs: BlobStore) -> None:
        self._database = database
        self._blobs = blobs
        self._log_may_hold_erased = True  # nobody knows what the process before this one left in SQLite's log

    def delete_wanted(self) -> int:
        """Delete what erasures want gone. Returns how many intents were carried out.

        Raises OSError for what the store does not delete; that waits, and does not hold up the others.
        """
        done = 0
        while True:
            with self._database.read() as session:
                wanted = people_privacy.wanted_deletions(session, BATCH)
            if not wanted:
                break
            gone, fault = self._delete_all(wanted)
            with self._database.write() as session:
                people_privacy.forget_deletions(session, gone)
            self._log_may_hold_erased = True
            done += len(gone)
            if fault is not None:
                raise fault
        if self._log_may_hold_erased and self._database.empty_log():
            self._log_may_hold_erased = False
        return done

    def delete_orphans(self, grace: timedelta = ORPHAN_GRACE) -> int:
        """All of `orphan_batches`. Returns how many blobs went."""
        return sum(self.orphan_batches(grace))

    def orphan_batches(self, grace: timedelta = ORPHAN_GRACE) -> Iterator[int]:
        """Delete blobs older than the grace time that no row names; after each batch of the listing, how many.

        An upload that failed after sealing, a worker that went on with an erased job and a store that was restored from
        a backup leave such, also beside what is named of the same meal.
        """
        before, strange = datetime.now(UTC) - grace, 0
        everything = self._blobs.keys()
        old = (blob.key for blob in everything if blob.stored_at < before)
        while keys := list(islice(old, BATCH)):
            with self._database.read() as session:
                ours = privacy.of_known_studies(session, keys)
                orphans = sorted(ours - privacy.needed_keys(session, ours))
            strange += len(keys) - len(ours)
            yield self._delete_orphans(orphans, before)
        if strange:  # no study is ever deleted: this store is another database's, or the other way round
            log.error("blobs_of_no_study", count=strange)

    def tidy(self) -> None:
        """Remove what processes that died left in this machine's staging folder."""
        self._blobs.remove_abandoned()

    def _delete_orphans(self, keys: Sequence[str], before: datetime) -> int:
        """Look once more: a photograph that was sent again since the batch was read is young now, or has its row.

        The keys are spent, in one short transaction, before the first is deleted, so whoever has just sealed one of
        them cannot name it (docs/storage.md).
        """
        old = [key for key in keys if self._is_old(key, before)]
        if not old:  # as of nearly every batch: a listing keeps no writer waiting
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
        beside = self._blobs.keys(key.rpartition("/")[0] + "/")
        return any(blob.key == key and blob.stored_at < before for blob in beside)

    def _delete_all(self, keys: Sequence[str]) -> tuple[list[str], OSError | None]:
        """Those that are gone, and the last fault."""
        gone: list[str] = []
        fault, in_a_row = None, 0
        for key in keys:
            try:
                self._delete(key)
            except OSError as error:
                fault, in_a_row = error, in_a_row + 1
                if in_a_row == FAULTS_IN_A_ROW:
                    break
            else:
                gone.append(key)
                in_a_row = 0
        return gone, fault

    def _delete(self, key: str) -> None:
        with self._database.read() as session:
            if privacy.is_named(session, key):
                log.error("deletion_refused", reason="a row names the blob")
                return
        keys = [blob.key for blob in self._blobs.keys(key)] if key.endswith("/") else [key]
        for one in keys:
            self._blobs.delete(one)
            instruments.BLOBS_DELETED.labels("erased").inc()
