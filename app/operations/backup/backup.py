"""`tada backup`: write database and blobs as of one moment to one file, while servers and workers continue.

First come the rows, read in one transaction, then the blobs that they name. A blob erased in between is not a fault; a
missing or damaged one is reported by name, and all others are in the backup. It does not contain the ledger of
erasures, which a restore reapplies, nor TADA_SECRET_KEY.
"""

import errno
import gzip
import hashlib
import os
import secrets
import uuid
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import app
from app.core.errors import ConflictError, InvalidInputError
from app.db.layout import TableLayout, layout_at
from app.db.migrate import SchemaUnknownError
from app.db.schema_state import current_revision, revisions
from app.db.scratch_keys import ScratchKeys, scratch_keys
from app.db.session import Database
from app.db.snapshot import Snapshot, snapshot_of
from app.operations.backup.backup_blobs import MISSING, read_blobs
from app.operations.backup.backup_format import (
    BLOB_COLUMNS,
    BLOBS,
    CHUNK_BYTES,
    END,
    ERASED,
    FORMAT,
    LACKING,
    MANIFEST,
    MAX_CHUNK_BYTES,
    MAX_DAMAGED_LISTED,
    MAX_LACKING_BYTES,
    SUMS,
    Backup,
    End,
    Manifest,
    chunk_name,
    key_check,
    lacking_line,
    manifest_tables,
)
from app.operations.backup.backup_tar import PIECE_BYTES, TarWriter
from app.operations.backup.backup_values import row_writer
from app.people.access.secret_box import SecretBox
from app.privacy import queries as privacy
from app.storage.blob_store import BlobStore

NO_LINKS = frozenset({errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS})  # errors of file systems without hard links
COMPRESSION = 3  # of rows, by gzip; photographs do not shrink
ReportProgress = Callable[[str], None]  # receives readable progress


def backup_to_file(
    database: Database, blobs: BlobStore, box: SecretBox, path: Path, report_progress: ReportProgress
) -> Backup:
    """Write a backup file, readable by its owner only; it gets its name once it is complete and on disk.

    Raises ConflictError (`backup_exists`) if the file exists or is created meanwhile; OSError.
    """
    _require_unused_name(path)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "wb") as file:
            backup = write_backup(database, blobs, box, file, report_progress)
            file.flush()
            os.fsync(file.fileno())
        _publish(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
    return backup


def write_backup(
    database: Database, blobs: BlobStore, box: SecretBox, out: IO[bytes], report_progress: ReportProgress
) -> Backup:
    """Write the backup sequentially. An interrupted one lacks its end and is refused by a restore."""
    revision = current_revision(database)
    if revision is None:
        raise InvalidInputError("There is nothing to back up: the database has no tables.", code="nothing_to_back_up")
    if revision not in revisions():
        raise SchemaUnknownError(f"The schema ({revision}) is a newer program's: make the backup with that program.")
    layout = layout_at(revision)
    backup, now = str(uuid.uuid4()), datetime.now(UTC)
    manifest = Manifest(
        format=FORMAT,
        backup=backup,
        created_at=now,
        program=app.__version__,
        revision=revision,
        database="sqlite" if database.is_sqlite else "postgresql",
        key_check=key_check(box, backup),
        tables=manifest_tables(layout),
    )
    with scratch_keys() as keys, TemporaryFile() as sums, TemporaryFile() as lacking:
        tar = TarWriter(out, sums, int(now.timestamp()))
        tar.add_bytes(MANIFEST, manifest.to_bytes())
        with snapshot_of(database, revision, layout) as snapshot:
            rows = {table.name: _write_table(tar, snapshot, table, keys, report_progress) for table in layout}
        copied = _Blobs(database, blobs, lacking, report_progress)
        copied.write(tar, keys)
        _add_file(tar, LACKING, lacking)
        members = tar.members
        sums_sha256 = _add_file(tar, SUMS, sums)
        end = End(
            members=members,
            sums_sha256=sums_sha256,
            rows=rows,
            blobs=copied.count,
            blob_bytes=copied.bytes,
            erased=copied.erased,
            damaged=copied.damaged,
        )
        tar.add_bytes(END, end.to_bytes(box))
        tar.close()
    return Backup(manifest, end, copied.damaged_first)


class _Blobs:
    """Copies the blobs that rows name and counts the results. lacking: receives a line per blob not copied."""

    def __init__(
        self, database: Database, blobs: BlobStore, lacking: IO[bytes], report_progress: ReportProgress
    ) -> None:
        self._database, self._blobs, self._lacking = database, blobs, lacking
        self._report_progress = report_progress
        self.count = self.bytes = self.erased = self.damaged = 0
        self.damaged_first: dict[str, str] = {}

    def write(self, tar: TarWriter, keys: ScratchKeys) -> None:
        for blob in read_blobs(self._blobs, keys.named()):
            if blob.fault is None:
                tar.add(BLOBS + blob.key, blob.size, blob.pieces())
                self.count += 1
                self.bytes += blob.size
                self._report_progress(f"{self.count} blobs, {self.bytes / 1e6:.0f} MB")
            elif blob.fault == MISSING and self._is_erased(blob.key):
                self.erased += 1
                self._note(blob.key, ERASED)
            else:
                self.damaged += 1
                self._note(blob.key, blob.fault)
                if len(self.damaged_first) < MAX_DAMAGED_LISTED:
                    self.damaged_first[blob.key] = blob.fault

    def _note(self, key: str, reason: str) -> None:
        line = lacking_line(key, reason)
        if len(line) > MAX_LACKING_BYTES:
            raise InvalidInputError("A row names a blob by a key longer than any key.", code="database_inconsistent")
        self._lacking.write(line)

    def _is_erased(self, key: str) -> bool:
        """Return whether a missing blob was erased: only an erasure deletes the row that named it, before the blob."""
        with self._database.read() as session:
            return not privacy.is_named(session, key)


def _write_table(
    tar: TarWriter, snapshot: Snapshot, table: TableLayout, keys: ScratchKeys, report_progress: ReportProgress
) -> int:
    name_blob = blob_namer(table, keys)
    write, count, number, chunk = row_writer(table), 0, 0, bytearray()
    for row in snapshot.rows(table):
        try:
            line = write(row)
        except (TypeError, ValueError, AttributeError) as error:
            raise InvalidInputError(
                f"Table {table.name} has a value of another type than its column: it could not be restored.",
                code="database_inconsistent",
            ) from error
        if len(line) > MAX_CHUNK_BYTES:
            raise InvalidInputError(f"A row of {table.name} is too large for a backup.", code="database_inconsistent")
        if chunk and len(chunk) + len(line) > CHUNK_BYTES:
            number += 1
            tar.add_bytes(chunk_name(table.name, number), gzip.compress(chunk, COMPRESSION, mtime=0))
            chunk.clear()
            report_progress(f"{table.name}: {count} rows")
        chunk += line
        count += 1
        name_blob(row)
    if chunk:
        tar.add_bytes(chunk_name(table.name, number + 1), gzip.compress(chunk, COMPRESSION, mtime=0))
    report_progress(f"{table.name}: {count} rows")
    return count


def blob_namer(table: TableLayout, keys: ScratchKeys) -> Callable[[Sequence[object]], None]:
    """Return a function that adds the blob named by a row of this table to `keys`, unless it is erased."""
    columns = BLOB_COLUMNS.get(table.name)
    key = table.place(columns[0]) if columns else None
    erased = table.place(columns[1]) if columns and columns[1] else None

    def name(row: Sequence[object]) -> None:
        if key is not None and (erased is None or row[erased] is None):
            keys.name(str(row[key]))

    return name


def _add_file(tar: TarWriter, name: str, file: IO[bytes]) -> str:
    """Add the content of a temporary file as a member, and return its checksum."""
    size = file.tell()
    digest = hashlib.sha256()

    def pieces() -> Iterator[bytes]:
        file.seek(0)
        remaining = size
        while remaining:
            piece = file.read(min(PIECE_BYTES, remaining))
            digest.update(piece)
            remaining -= len(piece)
            yield piece

    tar.add(name, size, pieces())
    return digest.hexdigest()


def _require_unused_name(path: Path) -> None:
    if path.exists():
        raise _exists_error(path)


def _publish(partial: Path, path: Path) -> None:
    """Give the complete file its name unless the name exists; checking first and then renaming could overwrite."""
    try:
        os.link(partial, path)
    except FileExistsError:
        raise _exists_error(path) from None
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        _publish_without_links(partial, path)
    else:
        partial.unlink()


def _publish_without_links(partial: Path, path: Path) -> None:
    """Do so on file systems without hard links: reserve the name by an empty file, which the rename replaces."""
    try:
        path.touch(mode=0o600, exist_ok=False)
    except FileExistsError:
        raise _exists_error(path) from None
    try:
        partial.rename(path)
    except BaseException:
        path.unlink()
        raise


def _exists_error(path: Path) -> ConflictError:
    return ConflictError(f"{path} exists already: a backup overwrites nothing.", code="backup_exists")
