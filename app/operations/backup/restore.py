"""`tada restore`: restore a backup to an empty deployment: tables, blobs, then all rows or none.

The whole backup, the target and the ledger of erasures are checked before anything is written: of
the backup first its seal, which is over every byte, then what its members are. An interrupted
restore can be repeated: blobs stored already are identical. At the end, erasures from after the
backup are reapplied (operations/prepare.py) and waiting meals are queued again.
"""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psycopg
import pyarrow as pa
import pyarrow.compute as pc
import sqlalchemy as sa
from sqlalchemy.exc import OperationalError, StatementError

from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.db.bulk import insert_into
from app.db.migrate import create_triggers, drop_triggers
from app.db.session import Database
from app.jobs.queue import JobQueue, sweep
from app.meals.stored.job_models import Job
from app.operations.backup.archive import (
    BLOBS,
    LACKING,
    MANIFEST,
    Backup,
    Manifest,
    ReportProgress,
    broken,
    members,
    read_manifest,
    verify_seal,
)
from app.operations.backup.blob_files import is_blob_key, store_blobs
from app.operations.backup.table_files import read_file, tables_at
from app.operations.backup.target import (
    make_tables,
    require_empty_database,
    require_ledger,
    require_store,
)
from app.operations.backup.write_backup import Tables
from app.operations.prepare import prepare
from app.people.access import audit
from app.people.access.secret_box import existing_secret_box
from app.privacy.erasure_ledger import KINDS
from app.records.project_records import project_meal
from app.storage.blob_store import BlobStore

TABLE_FILE = re.compile(r"^tables/([a-z0-9_]+)/[0-9]{6,}\.parquet$")


def check_backup(
    file: IO[bytes],
    settings: Settings,
    report: ReportProgress,
    *,
    other_key: bool = False,
) -> Backup:
    """Read and verify a backup. other_key: its key is lost.

    Raises InvalidInputError (`backup_broken`, `backup_too_new`, `backup_too_old`), SecretKeyError.
    """
    manifest = read_manifest(file)
    verify_seal(file, existing_secret_box(settings), report, other_key=other_key)
    backup = Backup(manifest, dict.fromkeys(tables_at(manifest.revision), 0))
    for name, size, content in members(file):
        table = table_of(name, backup)
        if table is not None:
            _check_table(backup, name, table, content.read())
        elif name.startswith(BLOBS):
            if not is_blob_key(name.removeprefix(BLOBS)):
                raise broken(f"{name} is not a blob")
            backup.count_blob(size)
        elif name == LACKING:
            _check_lacking(backup, content)
        elif name != MANIFEST:
            raise broken(f"{name} does not belong to it")
    return backup


def table_of(name: str, backup: Backup) -> sa.Table | None:
    """Return the table whose rows a member has; None: it has none."""
    match = TABLE_FILE.match(name)
    if match is None:
        return None
    table = tables_at(backup.manifest.revision).get(match[1])
    if table is None:
        raise broken(f"its schema has no table {match[1]}")
    return table


def _check_table(backup: Backup, name: str, table: sa.Table, content: bytes) -> None:
    try:
        for rows in read_file(content, table):
            backup.tables[table.name] += rows.num_rows
            if table.name == "tombstone":
                for row in rows.select(["kind", "digest"]).to_pylist():
                    if row["kind"] in KINDS:
                        backup.erasures.add(f"{row['kind']}/{row['digest']}")
    except ValueError as error:
        raise broken(f"{name}: {error}") from error


def _check_lacking(backup: Backup, content: IO[bytes]) -> None:
    for line in content:
        try:
            key, reason = map(str, json.loads(line))
        except (ValueError, TypeError) as error:
            raise broken(f"{LACKING} has an invalid line") from error
        backup.count_lacking(key, reason)


def _of_tables(query: str) -> sa.TextClause:
    return sa.text(query).bindparams(sa.bindparam("tables", expanding=True))


# Added to every change's number, so that clients that have read changes made after the backup get
# all of its changes again. Larger than the number of changes between backup and restore, small
# enough for a thousand million restores.
CHANGE_SEQ_JUMP = 2**32
ERASED_AT_A_TIME = 500  # keys in a statement
INDEXES = {
    "sqlite": _of_tables("""
        SELECT name, sql FROM sqlite_master
        WHERE type = 'index' AND sql IS NOT NULL AND tbl_name IN :tables
    """),
    "postgresql": _of_tables("""
        SELECT indexname, indexdef FROM pg_indexes
        WHERE schemaname = current_schema() AND tablename IN :tables
            AND indexname NOT IN (SELECT conname FROM pg_constraint)
    """),
}
FOREIGN_KEYS = _of_tables("""
    SELECT relname, conname, pg_get_constraintdef(pg_constraint.oid)
    FROM pg_constraint JOIN pg_class ON pg_class.oid = conrelid
    WHERE contype = 'f' AND connamespace = current_schema()::regnamespace AND relname IN :tables
""")
SQLITE_CACHE_KIB = 64 * 1024  # ids are random, so index pages are written in random order


@dataclass(frozen=True, slots=True)
class RestoreDone:
    """Result of a restore.

    queued_again: meals that waited for their estimate
    missing_in_ledger: erasures that the backup records and the ledger lacks, so that it is not the
        original ledger
    """

    checked: Backup
    queued_again: int
    missing_in_ledger: int


def restore(
    path: Path,
    database: Database,
    blobs: BlobStore,
    settings: Settings,
    report: ReportProgress,
    *,
    other_key: bool = False,
    other_ledger: bool = False,
) -> RestoreDone:
    """Restore a backup to an empty deployment that is not running.

    other_key: accept a different secret key
    other_ledger: accept a different ledger of erasures
    Raises InvalidInputError (`backup_broken`, `backup_too_new`, `backup_too_old`,
    `backup_refused`), SecretKeyError, ConflictError (`deployment_in_use`, `deployment_not_empty`,
    `ledger_differs`), StorageFullError, OSError of a store. They are raised before anything is
    written, except `backup_refused`, which leaves blobs, and failures of writing.
    """
    with path.open("rb") as file:
        require_empty_database(database)
        checked = check_backup(file, settings, report, other_key=other_key)
        require_empty_database(database)  # again: the check may have taken an hour
        require_store(blobs, file, checked)
        missing_in_ledger = require_ledger(settings, checked.erasures, other_ledger=other_ledger)
        make_tables(database, checked.manifest.revision)
        store_blobs(file, blobs, report)
        tables = tables_at(checked.manifest.revision)
        with _filling(database, tables) as connection:
            _insert_rows(connection, file, checked, report)
            _mark_erased(connection, checked, tables)
    prepare(database, settings)
    queued_again = _put_to_work(database, checked.manifest)
    return RestoreDone(checked, queued_again, missing_in_ledger)


@contextmanager
def _filling(database: Database, tables: Tables) -> Iterator[sa.Connection]:
    """Yield a transaction to insert rows.

    Indexes, foreign keys and triggers are dropped meanwhile, which takes a third of the time, and
    created again in the same transaction.
    Raises InvalidInputError (`backup_refused`) for rows that this database refuses.
    """
    with _explained_refusal("all tables"), database.write() as session:
        connection = session.connection()
        statements = []
        if database.is_sqlite:
            connection.exec_driver_sql("PRAGMA defer_foreign_keys = ON")  # until the commit
            connection.exec_driver_sql(f"PRAGMA cache_size = -{SQLITE_CACHE_KIB}")
        else:
            for setting in ("statement_timeout", "idle_in_transaction_session_timeout"):
                connection.exec_driver_sql(f"SET LOCAL {setting} = 0")
            statements = _drop_foreign_keys(connection, list(tables))
        drop_triggers(connection)
        statements = _drop_indexes(connection, list(tables)) + statements
        yield connection
        for statement in statements:
            connection.execute(sa.text(statement))
        create_triggers(connection)
        if not database.is_sqlite:
            for table in tables.values():
                _advance_sequence(connection, table)
                connection.exec_driver_sql(f"ANALYZE {_quoted(connection, table.name)}")


def _drop_indexes(connection: sa.Connection, tables: list[str]) -> list[str]:
    """Drop all indexes but those of constraints, and return the statements that create them."""
    statements = []
    indexes = connection.execute(INDEXES[connection.dialect.name], {"tables": tables}).all()
    for name, definition in indexes:
        connection.exec_driver_sql(f"DROP INDEX {_quoted(connection, name)}")
        statements.append(definition)
    return statements


def _drop_foreign_keys(connection: sa.Connection, tables: list[str]) -> list[str]:
    """Drop PostgreSQL's foreign keys, and return the statements that create and check them."""
    statements = []
    for table, name, definition in connection.execute(FOREIGN_KEYS, {"tables": tables}).all():
        alter = f"ALTER TABLE {_quoted(connection, table)}"
        constraint = f"CONSTRAINT {_quoted(connection, name)}"
        connection.exec_driver_sql(f"{alter} DROP {constraint}")
        statements.append(f"{alter} ADD {constraint} {definition}")
    return statements


def _quoted(connection: sa.Connection, name: str) -> str:
    return connection.dialect.identifier_preparer.quote(name)


def _advance_sequence(connection: sa.Connection, table: sa.Table) -> None:
    """Let PostgreSQL number new rows after those inserted; does nothing without a sequence."""
    column = table.autoincrement_column
    if column is not None:
        sequence = sa.func.pg_get_serial_sequence(table.name, column.name)
        last = sa.select(sa.func.max(column)).scalar_subquery()
        connection.execute(sa.select(sa.func.setval(sequence, last)))


def _insert_rows(
    connection: sa.Connection,
    file: IO[bytes],
    checked: Backup,
    report: ReportProgress,
) -> None:
    for name, _, content in members(file):
        table = table_of(name, checked)
        if table is None:
            continue
        try:
            for batch in read_file(content.read(), table):
                rows = _with_later_changes(batch).to_pylist()
                with _explained_refusal(table.name):
                    insert_into(connection, table, rows)
        except ValueError as error:
            raise broken(f"{name}: {error}") from error
        report(f"restored: {name}")


def _with_later_changes(rows: pa.RecordBatch) -> pa.RecordBatch:
    place = rows.schema.get_field_index("change_seq")
    if place < 0:
        return rows
    later = pc.add_checked(rows.column(place), CHANGE_SEQ_JUMP)
    return rows.set_column(place, "change_seq", later)


def _mark_erased(connection: sa.Connection, checked: Backup, tables: Tables) -> None:
    """Mark blobs erased while the backup was written: its rows are from before the erasure."""
    for first in range(0, len(checked.erased), ERASED_AT_A_TIME):
        keys = checked.erased[first : first + ERASED_AT_A_TIME]
        image, artefact = tables["meal_image"], tables["run_artefact"]
        kept = sa.update(image).where(image.c.blob_key.in_(keys), image.c.erased_at.is_(None))
        connection.execute(kept.values(erased_at=checked.manifest.created_at))
        connection.execute(sa.delete(artefact).where(artefact.c.blob_key.in_(keys)))
        _fail_releases(connection, tables, keys)


def _fail_releases(connection: sa.Connection, tables: Tables, keys: list[str]) -> None:
    """Mark releases that were rewritten while the backup was written: it lacks their old files.

    The others may contain erased data: no row names them any more, so they are deleted as orphans.
    """
    release, file, change = (tables[name] for name in ("release", "release_file", "release_change"))
    failed = sa.select(file.c.release_id).where(file.c.blob_key.in_(keys))
    values = {"state": "failed", "failure_code": "release_files_missing", "claim": None}
    connection.execute(sa.update(release).where(release.c.id.in_(failed)).values(values))
    connection.execute(sa.delete(change).where(change.c.release_id.in_(failed)))
    connection.execute(sa.delete(file).where(file.c.release_id.in_(failed)))


def _put_to_work(database: Database, manifest: Manifest) -> int:
    """Record the restore and requeue running jobs, which no worker runs here."""
    with database.write() as session:
        waiting = session.execute(
            sa.update(Job)
            .where(Job.finished_at.is_(None))
            .values(state="queued", executor_id=None, result_key=None)
            .returning(Job.id)
        ).all()
        made_at = manifest.created_at.isoformat()
        audit.note(session, None, "server.restore", subject=manifest.backup, backup_made_at=made_at)
    return len(waiting) + sweep(database, JobQueue(), project_meal)


@contextmanager
def _explained_refusal(place: str) -> Iterator[None]:
    """Raise `backup_refused` for values that the database refuses, without quoting them."""
    try:
        yield
    except (OperationalError, psycopg.OperationalError):
        raise
    except (StatementError, psycopg.Error) as error:  # COPY bypasses SQLAlchemy
        reason = type(getattr(error, "orig", error)).__name__
        message = f"The database refuses the backup's rows: {place}: {reason}."
        whole = f"{message} None of them was stored."
        raise InvalidInputError(whole, code="backup_refused") from None
