"""Check where a backup is to be restored: database and store are empty, the ledger is the original.

With another ledger people erased after the backup would come back with it, or the restored
deployment would refuse to start.
"""

import contextlib
import sqlite3
import time
from itertools import islice
from pathlib import Path
from typing import IO

import sqlalchemy as sa

from app.core.errors import ConflictError, InvalidInputError, StorageFullError
from app.core.settings import Settings
from app.db.migrate import downgrade, upgrade
from app.db.schema_state import current_revision
from app.db.session import Database
from app.operations.backup.archive import BLOBS, Backup, members
from app.operations.backup.table_files import known_revision, tables_at
from app.people.access.secret_box import SecretKeyError, existing_secret_box
from app.privacy.erasure_ledger import KINDS, ErasureLedger
from app.storage.blob_store import BlobStore
from app.storage.local import LocalBlobStore
from app.storage.opening import open_blob_store

LEAVE_SECONDS = 10.0  # until closed connections are gone, which takes seconds on a busy machine
OTHERS = """
    SELECT count(*) FROM pg_stat_activity
    WHERE datname = current_database() AND pid <> pg_backend_pid() AND usename = current_user
"""


def require_empty_database(database: Database) -> None:
    """Require that no one else has the database open, and that it is new, with a known schema.

    Raises ConflictError: `deployment_in_use`, `deployment_not_empty`, `schema_unknown`.
    """
    database.dispose()
    if not (_is_alone_on_sqlite if database.is_sqlite else _is_alone_on_postgres)(database):
        raise ConflictError(
            "Another process has the database open: stop servers, workers and other clients "
            "connected as the same user, then try again.",
            code="deployment_in_use",
        )
    revision = known_revision(database)
    filled = None if revision is None else _filled_table(database, revision)
    if filled is not None:
        raise ConflictError(
            f"This deployment has data already (table {filled}): restore into an empty one, and "
            "move the data over there or delete it yourself.",
            code="deployment_not_empty",
        )


def make_tables(database: Database, revision: str) -> None:
    """Create the empty tables of a revision, replacing those of an empty deployment."""
    if current_revision(database) is not None:
        downgrade(database, "base")
    upgrade(database, revision)


def require_store(blobs: BlobStore, file: IO[bytes], checked: Backup) -> None:
    """Require that the store is writable, has room, and has only blobs of an interrupted restore.

    Raises ConflictError (`deployment_not_empty`), StorageFullError, OSError.
    """
    blobs.check()
    stored = {blob.key: blob.size for blob in islice(blobs.keys(), checked.blobs + 1)}
    others = set(stored)
    if stored:
        others.difference_update(name.removeprefix(BLOBS) for name, _, _ in members(file))
    if others:
        raise ConflictError(
            "The blob store has blobs that are not of this backup: restore into an empty one.",
            code="deployment_not_empty",
        )
    needed_bytes = checked.blob_bytes - sum(stored.values())
    free_bytes = blobs.free_bytes()
    if isinstance(blobs, LocalBlobStore) and free_bytes < needed_bytes:  # a bucket has no limit
        free_text = f"the store has {free_bytes / 1e9:.1f} GB left"
        raise StorageFullError(f"The blobs need {needed_bytes / 1e9:.1f} GB, and {free_text}.")


def require_ledger(settings: Settings, recorded: set[str], *, other_ledger: bool) -> int:
    """Return how many erasures of the backup the ledger lacks.

    recorded: keys of the erasures in the backup
    other_ledger: accept a ledger that lacks some
    Raises ConflictError (`ledger_differs`), SecretKeyError for entries to reapply that were made
    with another key, InvalidInputError (`ledger_broken`), OSError.
    """
    store = open_blob_store(settings.resolved_erasure_url, settings)
    box = existing_secret_box(settings)
    ledger = ErasureLedger(store, box) if box is not None else None
    missing = set(recorded)
    for kind in KINDS:
        for blob in store.keys(f"{kind}/"):
            if blob.key not in recorded:
                _require_entry(ledger, blob.key)
            missing.discard(blob.key)
    if missing and not other_ledger:
        raise ConflictError(
            f"The ledger of erasures ({settings.resolved_erasure_url}) lacks {len(missing)} "
            "erasures that the backup records, so it is not the original ledger: whoever was "
            "erased after the backup would come back. Set TADA_ERASURE_URL to the original ledger, "
            "or copy its entries here. If it is lost: --other-ledger. Nothing was restored.",
            code="ledger_differs",
        )
    return len(missing)


def _require_entry(ledger: ErasureLedger | None, key: str) -> None:
    """Require that an erasure from after the backup can be read, so that it can be reapplied."""
    kind, _, digest = key.partition("/")
    try:
        if ledger is not None:
            ledger.read("meal" if kind == "meal" else "participant", digest)
            return
    except SecretKeyError:
        pass
    except (ValueError, KeyError, TypeError) as error:
        raise InvalidInputError(
            f"The ledger of erasures has an invalid entry: {key}. Nothing was restored.",
            code="ledger_broken",
        ) from error
    raise SecretKeyError(
        "The ledger has erasures from after the backup, made with another TADA_SECRET_KEY: they "
        "cannot be read, so the people they erased would come back. Set the original key. If it is "
        "lost, set TADA_ERASURE_URL to another place (--other-ledger), and erase them again. "
        "Nothing was restored."
    )


def _is_alone_on_postgres(database: Database) -> bool:
    deadline = time.monotonic() + LEAVE_SECONDS
    with database.read() as session:
        while session.scalar(sa.text(OTHERS)):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)
    return True


def _is_alone_on_sqlite(database: Database) -> bool:
    """Return whether no one else has the file open: only then can WAL mode be left.

    The next connection restores it.
    """
    path = sa.make_url(database.url).database
    if not path or not Path(path).exists():
        return True
    with contextlib.closing(sqlite3.connect(path, timeout=LEAVE_SECONDS)) as connection:
        try:
            mode = connection.execute("PRAGMA journal_mode = DELETE").fetchone()[0]
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY:
                raise
            return False
    return bool(mode == "delete")


def _filled_table(database: Database, revision: str) -> str | None:
    """Return the first table with rows that a new deployment does not have."""
    with database.read() as session:
        for table in tables_at(revision).values():
            query = sa.select(sa.literal(1)).select_from(table).limit(1)
            if table.name == "food_release":
                query = query.where(table.c.source != "starter")
            elif table.name == "component" or table.name.startswith("food_"):
                continue
            if session.execute(query).first() is not None:
                return table.name
    return None
