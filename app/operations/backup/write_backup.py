"""`tada backup`: write database and blobs as of one moment to one file, while servers continue.

First come the rows, read in one transaction, then the blobs that they name. A blob erased in
between is not a fault; a missing or damaged one is reported by name, and all others are in the
backup. It does not contain the ledger of erasures, which a restore reapplies, nor TADA_SECRET_KEY.
"""

import json
import os
import secrets
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import sqlalchemy as sa

import app
import app.tables
from app.core.errors import ConflictError, InvalidInputError, UnavailableError
from app.db.base import Base
from app.db.schema_state import revision_of
from app.db.session import Database
from app.operations.backup.archive import (
    BLOBS,
    ERASED,
    FORMAT,
    LACKING,
    MANIFEST,
    TABLES,
    ArchiveWriter,
    Backup,
    Manifest,
    ReportProgress,
)
from app.operations.backup.blob_files import MISSING, read_blobs
from app.operations.backup.table_files import (
    ROWS_AT_A_TIME,
    known_revision,
    tables_at,
    write_files,
)
from app.people.access import audit
from app.people.access.secret_box import SecretBox
from app.people.privacy_models import BACKUP_MADE
from app.privacy import queries as privacy
from app.storage.blob_store import BlobStore

Tables = Mapping[str, sa.Table]
BLOB_COLUMNS = {  # table -> the columns that name a blob
    mapper.class_.__tablename__: mapper.class_.blob
    for mapper in Base.registry.mappers
    if mapper.class_.blob is not None
}


def backup_to_file(
    database: Database,
    blobs: BlobStore,
    box: SecretBox,
    path: Path,
    report: ReportProgress,
) -> Backup:
    """Write a backup file, readable by its owner only; it gets its name once it is complete.

    Raises ConflictError (`backup_exists`) if the file exists or is created meanwhile; OSError.
    """
    if path.exists():
        raise _exists_error(path)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "wb") as file:
            backup = write_backup(database, blobs, box, file, report)
            file.flush()
            os.fsync(file.fileno())
        _publish(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return backup


def write_backup(
    database: Database, blobs: BlobStore, box: SecretBox, out: IO[bytes], report: ReportProgress
) -> Backup:
    """Write the backup sequentially. An interrupted one lacks its seal and cannot be restored."""
    revision, now = known_revision(database), datetime.now(UTC)
    if revision is None:
        message = "There is nothing to back up: the database has no tables."
        raise InvalidInputError(message, code="nothing_to_back_up")
    manifest = Manifest(
        format=FORMAT,
        backup=str(uuid.uuid4()),
        created_at=now,
        program=app.__version__,
        revision=revision,
        database="sqlite" if database.is_sqlite else "postgresql",
    )
    archive = ArchiveWriter(out, int(now.timestamp()))
    archive.add_bytes(MANIFEST, manifest.model_dump_json(indent=1).encode())
    tables = tables_at(revision)
    backup = Backup(manifest, dict.fromkeys(tables, 0))
    with TemporaryFile() as named, TemporaryFile() as lacking:
        with _snapshot(database, revision, tables) as connection:
            for table in tables.values():
                _write_table(archive, connection, table, backup, report)
            for key in _named_keys(connection, tables):
                named.write(json.dumps(key).encode() + b"\n")
        named.seek(0)
        for copy in read_blobs(blobs, map(json.loads, named)):
            if copy.path is not None:
                size = copy.path.stat().st_size
                with copy.path.open("rb") as content:
                    archive.add(BLOBS + copy.key, content, size)
                backup.count_blob(size)
                report(f"{backup.blobs} blobs, {backup.blob_bytes / 1e6:.0f} MB")
                continue
            is_erased = copy.fault == MISSING and _is_erased(database, copy.key)
            reason = ERASED if is_erased else copy.fault
            backup.count_lacking(copy.key, reason)
            lacking.write(json.dumps([copy.key, reason]).encode() + b"\n")
        size = lacking.tell()
        lacking.seek(0)
        archive.add(LACKING, lacking, size)
    archive.seal(box)
    return backup


def note_backup(database: Database, *, blobs: int, damaged: int, piped: bool = False) -> None:
    """Record a complete backup in the audit log, where `tada doctor` and /metrics read it.

    damaged: number of blobs that it lacks
    piped: it was sent to another program, which may not have stored it
    """
    with database.write() as session:
        audit.note(session, None, BACKUP_MADE, blobs=blobs, damaged=damaged, piped=piped)


@contextmanager
def _snapshot(database: Database, revision: str, tables: Tables) -> Iterator[sa.Connection]:
    """Yield a connection that reads all tables as of now, while others continue to write.

    SQLite: a read transaction over the write-ahead log, which grows until it ends. PostgreSQL:
    REPEATABLE READ, with the tables locked against migrations before the first query, as pg_dump
    does. Raises UnavailableError if the schema has just been migrated.
    """
    with database.read() as session:
        connection = session.connection()
        if not database.is_sqlite:
            for setting in ("statement_timeout", "idle_in_transaction_session_timeout"):
                connection.exec_driver_sql(f"SET LOCAL {setting} = 0")
            names = ", ".join(map(connection.dialect.identifier_preparer.quote, tables))
            connection.exec_driver_sql(f"LOCK TABLE {names} IN ACCESS SHARE MODE")
        if revision_of(connection) != revision:
            raise UnavailableError("The schema has just been changed: try again.")
        yield connection


def _write_table(
    archive: ArchiveWriter,
    connection: sa.Connection,
    table: sa.Table,
    backup: Backup,
    report: ReportProgress,
) -> None:
    files = write_files(connection, table)
    for number, (rows, content) in enumerate(files, start=1):
        archive.add_bytes(f"{TABLES}{table.name}/{number:06d}.parquet", content)
        backup.tables[table.name] += rows
        report(f"{table.name}: {backup.tables[table.name]} rows")


def _named_keys(connection: sa.Connection, tables: Tables) -> Iterator[str]:
    """Yield the key of each blob that rows name, once; not those that the row says are erased."""
    queries = []
    for name, columns in BLOB_COLUMNS.items():
        if name not in tables:
            continue  # exports, and tables of a later revision
        stored = tables[name].c
        query = sa.select(stored[columns.key])
        if columns.erased_at is not None:
            query = query.where(stored[columns.erased_at].is_(None))
        queries.append(query)
    union = sa.union(*queries).execution_options(yield_per=ROWS_AT_A_TIME)
    yield from connection.execute(union).scalars()


def _is_erased(database: Database, key: str) -> bool:
    """Return whether a missing blob was erased: an erasure deletes the row before the blob."""
    with database.read() as session:
        return not privacy.is_named(session, key)


def _publish(partial: Path, path: Path) -> None:
    """Give the complete file its name, durably, unless the name was taken meanwhile."""
    try:
        path.touch(mode=0o600, exist_ok=False)  # reserves the name; the rename replaces it
    except FileExistsError:
        raise _exists_error(path) from None
    try:
        partial.rename(path)
    except BaseException:
        path.unlink()
        raise
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _exists_error(path: Path) -> ConflictError:
    message = f"{path} exists already: a backup overwrites nothing."
    return ConflictError(message, code="backup_exists")
