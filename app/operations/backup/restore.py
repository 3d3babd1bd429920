"""`tada restore`: restore a backup to an empty deployment: tables, blobs, then all rows or none.

The whole backup, the target and the ledger of erasures are checked before anything is written. An interrupted restore
can be repeated: blobs stored already are identical. At the end, erasures from after the backup are reapplied
(operations/prepare.py) and waiting meals are queued again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO

import sqlalchemy as sa

from app.core.errors import ConflictError, StorageFullError
from app.core.settings import Settings
from app.db.layout import TableLayout, layout_at
from app.db.migrate import SchemaUnknownError
from app.db.schema_state import current_revision, revisions
from app.db.scratch_keys import ScratchKeys
from app.db.session import Database
from app.jobs.queue import JobQueue
from app.jobs.sweep import sweep
from app.meals.job_models import Job
from app.operations.backup.backup import ReportProgress
from app.operations.backup.backup_check import CheckedBackup, check_backup, empty_named, unpacked_rows
from app.operations.backup.backup_format import BLOB_COLUMNS, MAX_CHUNK_BYTES, MAX_DOCUMENT_BYTES, Manifest, broken
from app.operations.backup.backup_tar import members
from app.operations.backup.backup_values import MOST_INTEGER, row_reader
from app.operations.backup.refill import Refill, make_tables, refilling, require_alone, require_empty
from app.operations.backup.restore_blobs import put_blobs
from app.operations.backup.restore_ledger import existing_box, require_ledger
from app.operations.prepare import prepare
from app.people.access import audit
from app.people.access.secret_box import KEY_FILE, SecretBox, SecretKeyError
from app.records.project_records import project_meal
from app.storage.blob_store import BlobStore
from app.storage.local import LocalBlobStore

# Added to every change's number, so that clients that have read changes made after the backup get all of its changes
# again. Larger than the number of changes between backup and restore, small enough for a thousand million restores.
CHANGE_SEQ_JUMP = 2**32
ERASED_AT_A_TIME = 500  # tables have no indexes at this time, so each query scans them


@dataclass(frozen=True, slots=True)
class RestoreDone:
    """Result of a restore. queued_again: meals that waited for their estimate.

    missing_in_ledger: erasures recorded in the backup but not in the ledger, so it is not the original ledger.
    """

    checked: CheckedBackup
    queued_again: int
    missing_in_ledger: int


def check_only(
    path: Path, settings: Settings, report_progress: ReportProgress, *, other_key: bool = False
) -> CheckedBackup:
    """Verify a backup completely without restoring it. Raises as check_backup."""
    with path.open("rb") as file, empty_named() as named:
        return check_backup(file, _key_of(settings, other_key=other_key), named, report_progress)


def restore(
    path: Path,
    database: Database,
    blobs: BlobStore,
    settings: Settings,
    report_progress: ReportProgress,
    *,
    other_key: bool = False,
    other_ledger: bool = False,
) -> RestoreDone:
    """Restore a backup to an empty deployment that is not running.

    other_key: accept a different secret key. other_ledger: accept a different ledger of erasures.
    Raises InvalidInputError (`backup_broken`, `backup_too_new`, `backup_too_old`, `backup_refused`), SecretKeyError,
    ConflictError (`deployment_in_use`, `deployment_not_empty`, `ledger_differs`), StorageFullError, OSError of a store.
    They are raised before anything is written, except `backup_refused`, which leaves blobs, and failures of writing.
    """
    with path.open("rb") as file, empty_named() as named:
        _require_free_database(database)  # again after the check, which may take an hour
        checked = check_backup(file, _key_of(settings, other_key=other_key), named, report_progress)
        _require_free_database(database)
        _require_store(blobs, named.blobs, checked.end.blob_bytes)
        missing_in_ledger = require_ledger(settings, named.erasures, other_ledger=other_ledger)
        make_tables(database, checked.manifest.revision, checked.layout)
        put_blobs(file, checked.blobs_offset, blobs, report_progress)
        with refilling(database, checked.layout) as refill:
            _put_rows(refill, file, checked, report_progress)
            _mark_erased(refill, checked, named.blobs)
    prepare(database, settings)
    return RestoreDone(checked, _put_to_work(database, checked.manifest), missing_in_ledger)


def _key_of(settings: Settings, *, other_key: bool) -> Callable[[Manifest], SecretBox | None]:
    def open_box(manifest: Manifest) -> SecretBox | None:
        """Return the key that the backup was sealed with. Raises SecretKeyError if this deployment has another."""
        if other_key:
            return None
        box = existing_box(settings)
        if box is None or box.digest("backup.key", manifest.backup) != manifest.key_check:
            raise SecretKeyError(
                "TADA_SECRET_KEY is not the key of this backup: without it erasures cannot be reapplied, and webhooks' "
                f"secrets cannot be opened. Set it, or put the file {KEY_FILE} of the old data folder into "
                f"{settings.data_dir}. If it is lost: --other-key."
            )
        return box

    return open_box


def _require_free_database(database: Database) -> None:
    """Require that no one else has the database open, and that it is empty, with a known schema."""
    require_alone(database)
    revision = current_revision(database)
    if revision is None:
        return
    if revision not in revisions():
        raise SchemaUnknownError(f"The database's schema ({revision}) is a newer program's: restore with that program.")
    require_empty(database, layout_at(revision))


def _require_store(blobs: BlobStore, keys: ScratchKeys, needed_bytes: int) -> None:
    """Require that the store is writable, has room, and has only blobs that an interrupted restore has left."""
    blobs.check()
    everything = blobs.keys()
    for blob in everything:
        if not keys.is_named(blob.key):
            raise ConflictError(
                "The blob store has blobs that are not of this backup: restore into an empty one.",
                code="deployment_not_empty",
            )
        needed_bytes -= blob.size
    free_bytes = blobs.free_bytes()
    if isinstance(blobs, LocalBlobStore) and free_bytes < needed_bytes:  # a bucket has no known limit
        raise StorageFullError(
            f"The blobs need {needed_bytes / 1e9:.1f} GB, and the store has {free_bytes / 1e9:.1f} GB left."
        )


def _put_rows(refill: Refill, file: IO[bytes], checked: CheckedBackup, report_progress: ReportProgress) -> None:
    chunks = members(file)
    next(chunks).content(MAX_DOCUMENT_BYTES)  # the manifest

    def rows_of(table: TableLayout) -> Iterator[Sequence[object]]:
        read, change = row_reader(table), table.place("change_seq")
        for sha256 in checked.chunks[table.name]:
            member = next(chunks)
            content = member.content(MAX_CHUNK_BYTES)
            if member.sha256 != sha256:
                raise broken("it was changed while it was read")
            for row in unpacked_rows(content, member.name, read):
                if change is not None and isinstance(number := row[change], int):
                    row[change] = _later(number)
                yield row

    for table in checked.layout:
        count = refill.put(table, rows_of(table))
        report_progress(f"restored: {table.name}, {count} rows")


def _later(change_seq: int) -> int:
    if change_seq > MOST_INTEGER - CHANGE_SEQ_JUMP:
        raise broken("its change numbers are too large")
    return change_seq + CHANGE_SEQ_JUMP


def _mark_erased(refill: Refill, checked: CheckedBackup, keys: ScratchKeys) -> None:
    """Mark blobs erased while the backup was written: the rows are from before the erasure, the blobs from after."""
    tables, erased = {table.name: table for table in checked.layout}, keys.erased()
    while batch := list(islice(erased, ERASED_AT_A_TIME)):
        for name, (key, erased_at) in BLOB_COLUMNS.items():
            if name not in tables:
                continue  # the backup predates the table
            table = tables[name].table()
            in_batch = table.c[key].in_(batch)
            if erased_at is not None and tables[name].place(erased_at) is not None:
                change = sa.update(table).values({erased_at: checked.manifest.created_at})
                refill.change(change.where(in_batch, table.c[erased_at].is_(None)))
            elif name == "release_file":
                _mark_release(refill, table, tables, in_batch)
            elif name == "run_artefact":
                refill.change(sa.delete(table).where(in_batch))


def _mark_release(
    refill: Refill, files: sa.TableClause, tables: Mapping[str, TableLayout], in_batch: sa.ColumnElement[bool]
) -> None:
    """Mark releases that were rewritten while the backup was written: the backup lacks some of their old files.

    The others may contain erased data: no row names them any more, so they are deleted as orphans.
    """
    release, changes = tables["release"].table(), tables["release_change"].table()
    broken = sa.select(files.c.release_id).where(in_batch)
    lost = {"state": "failed", "failure_code": "release_files_missing", "claim": None}
    refill.change(sa.update(release).where(release.c.id.in_(broken)).values(lost))
    refill.change(sa.delete(changes).where(changes.c.release_id.in_(broken)))
    refill.change(sa.delete(files).where(files.c.release_id.in_(broken)))


def _put_to_work(database: Database, manifest: Manifest) -> int:
    """Record the restore and requeue running jobs, which no worker runs here and whose results were not stored."""
    with database.write() as session:
        waiting = session.execute(
            sa.update(Job)
            .where(Job.finished_at.is_(None))
            .values(state="queued", executor_id=None, result_key=None)
            .returning(Job.id)
        ).all()
        audit.note(
            session, None, "server.restore", subject=manifest.backup, backup_made_at=manifest.created_at.isoformat()
        )
    return len(waiting) + sweep(database, JobQueue(), project_meal)
