"""`tada restore`: an empty deployment becomes what a backup holds: empty tables, blobs, then all rows or none.

The whole backup, the place that it comes to and the ledger of erasures are checked before anything is written. Broken
off, the same restore can be done again: the blobs that are there already are the same. At the end erasures that came
after the backup are done again (operations/prepare.py) and meals that waited are queued again.
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
from app.operations.backup.backup import Tell
from app.operations.backup.backup_check import CheckedBackup, check_backup, nothing_named, unpacked_rows
from app.operations.backup.backup_format import BLOB_COLUMNS, MAX_CHUNK_BYTES, MAX_DOCUMENT_BYTES, Manifest, broken
from app.operations.backup.backup_tar import members
from app.operations.backup.backup_values import MOST_INTEGER, row_reader
from app.operations.backup.refill import Refill, make_tables, refilling, require_alone, require_empty
from app.operations.backup.restore_blobs import put_blobs
from app.operations.backup.restore_ledger import box_that_is_there, require_ledger
from app.operations.prepare import prepare
from app.people.access import audit
from app.people.access.secret_box import KEY_FILE, SecretBox, SecretKeyError
from app.records.project_records import project_meal
from app.storage.blob_store import BlobStore
from app.storage.local import LocalBlobStore

# Added to every change's number: whoever pulled changes that the backup does not have stands before all that it has,
# and gets all of it again. Larger than any number of changes in between, small enough for a thousand million restores.
CHANGE_SEQ_JUMP = 2**32
ERASED_AT_A_TIME = 500  # tables have no indexes while they are filled: each time they are read whole


@dataclass(frozen=True, slots=True)
class RestoreDone:
    """What was restored. queued_again: meals that waited for their estimate.

    missing_in_ledger: erasures that the backup remembers and the ledger does not have, so it is not the ledger of then.
    """

    checked: CheckedBackup
    queued_again: int
    missing_in_ledger: int


def check_only(path: Path, settings: Settings, tell: Tell, *, other_key: bool = False) -> CheckedBackup:
    """Read a backup to its end as a restore would, and restore nothing. Raises as check_backup."""
    with path.open("rb") as file, nothing_named() as named:
        return check_backup(file, _key_of(settings, other_key=other_key), named, tell)


def restore(
    path: Path,
    database: Database,
    blobs: BlobStore,
    settings: Settings,
    tell: Tell,
    *,
    other_key: bool = False,
    other_ledger: bool = False,
) -> RestoreDone:
    """Restore a backup into an empty deployment that nobody runs.

    other_key: though the secret key is another. other_ledger: though the ledger of erasures is not that of then.
    Raises InvalidInputError (`backup_broken`, `backup_too_new`, `backup_too_old`, `backup_refused`), SecretKeyError,
    ConflictError (`deployment_in_use`, `deployment_not_empty`, `ledger_differs`), StorageFullError, OSError of a store.
    All of them before anything is written, but `backup_refused`, which leaves blobs, and what goes out of order on the
    way.
    """
    with path.open("rb") as file, nothing_named() as named:
        _require_free_database(database)  # at once, and again after the check, which may take an hour
        checked = check_backup(file, _key_of(settings, other_key=other_key), named, tell)
        _require_free_database(database)
        _require_store(blobs, named.blobs, checked.end.blob_bytes)
        missing_in_ledger = require_ledger(settings, named.erasures, other_ledger=other_ledger)
        make_tables(database, checked.manifest.revision, checked.layout)
        put_blobs(file, checked.blobs_offset, blobs, tell)
        with refilling(database, checked.layout) as refill:
            _put_rows(refill, file, checked, tell)
            _mark_erased(refill, checked, named.blobs)
    prepare(database, settings)
    return RestoreDone(checked, _put_to_work(database, checked.manifest), missing_in_ledger)


def _key_of(settings: Settings, *, other_key: bool) -> Callable[[Manifest], SecretBox | None]:
    def open_box(manifest: Manifest) -> SecretBox | None:
        """The key that the backup was sealed with. Raises SecretKeyError where it is not this deployment's."""
        if other_key:
            return None
        box = box_that_is_there(settings)
        if box is None or box.digest("backup.key", manifest.backup) != manifest.key_check:
            raise SecretKeyError(
                "TADA_SECRET_KEY is not the key of this backup: without it nobody knows who was erased, and webhooks' "
                f"secrets cannot be opened. Set it, or put the file {KEY_FILE} of the old data folder into "
                f"{settings.data_dir}. If it is lost: --other-key."
            )
        return box

    return open_box


def _require_free_database(database: Database) -> None:
    """Nobody else has it open, and it is empty, in a schema that we know."""
    require_alone(database)
    revision = current_revision(database)
    if revision is None:
        return
    if revision not in revisions():
        raise SchemaUnknownError(f"The database's schema ({revision}) is a newer program's: restore with that.")
    require_empty(database, layout_at(revision))


def _require_store(blobs: BlobStore, keys: ScratchKeys, needed_bytes: int) -> None:
    """It can be written, has no blobs but those that a restore of this backup left when it broke off, and has room."""
    blobs.check()
    everything = blobs.keys()
    for blob in everything:
        if not keys.is_named(blob.key):
            raise ConflictError(
                "The blob store holds something that is not of this backup: restore into an empty one.",
                code="deployment_not_empty",
            )
        needed_bytes -= blob.size
    free_bytes = blobs.free_bytes()
    if isinstance(blobs, LocalBlobStore) and free_bytes < needed_bytes:  # a bucket tells no limit
        raise StorageFullError(
            f"The blobs need {needed_bytes / 1e9:.1f} GB, and the store has {free_bytes / 1e9:.1f} GB left."
        )


def _put_rows(refill: Refill, file: IO[bytes], checked: CheckedBackup, tell: Tell) -> None:
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
        tell(f"restored: {table.name}, {count} rows")


def _later(change_seq: int) -> int:
    if change_seq > MOST_INTEGER - CHANGE_SEQ_JUMP:
        raise broken("it counts more changes than there can be")
    return change_seq + CHANGE_SEQ_JUMP


def _mark_erased(refill: Refill, checked: CheckedBackup, keys: ScratchKeys) -> None:
    """What an erasure took while the backup was written: the rows are from before it, the blobs from after it."""
    tables, erased = {table.name: table for table in checked.layout}, keys.erased()
    while some := list(islice(erased, ERASED_AT_A_TIME)):
        for name, (key, erased_at) in BLOB_COLUMNS.items():
            if name not in tables:
                continue  # the backup is of before there was such a table
            table = tables[name].table()
            of_some = table.c[key].in_(some)
            if erased_at is not None and tables[name].place(erased_at) is not None:
                change = sa.update(table).values({erased_at: checked.manifest.created_at})
                refill.change(change.where(of_some, table.c[erased_at].is_(None)))
            elif name == "release_file":
                _mark_release(refill, table, tables, of_some)
            elif name == "run_artefact":
                refill.change(sa.delete(table).where(of_some))


def _mark_release(
    refill: Refill, files: sa.TableClause, tables: Mapping[str, TableLayout], of_some: sa.ColumnElement[bool]
) -> None:
    """A release that was written anew while the backup was written: it has its old rows and not all their files.

    Those that it has may hold what was erased: no row names them, so they go as orphans.
    """
    release, changes = tables["release"].table(), tables["release_change"].table()
    broken = sa.select(files.c.release_id).where(of_some)
    lost = {"state": "failed", "failure_code": "release_files_missing", "claim": None}
    refill.change(sa.update(release).where(release.c.id.in_(broken)).values(lost))
    refill.change(sa.delete(changes).where(changes.c.release_id.in_(broken)))
    refill.change(sa.delete(files).where(files.c.release_id.in_(broken)))


def _put_to_work(database: Database, manifest: Manifest) -> int:
    """Note the restore, and let what was at work wait again: nobody here works on it, and its result is not stored."""
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
