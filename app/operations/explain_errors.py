"""Explain environmental errors in a sentence: database, store or disk down, full, or forbidden.

Only for errors that an operator can fix. Errors that look like bugs keep their traceback. Before a
process starts, `check_stores` sees whether the stores accept its configuration; a temporary outage
does not stop it.
"""

import errno
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

import psycopg
import sqlalchemy as sa
import structlog

from app.core.errors import InvalidInputError, StorageFullError, TadaError, UnavailableError
from app.core.settings import Settings
from app.db.session import is_disk_full
from app.storage.blob_store import BlobStore, StoreRefusesError
from app.storage.opening import open_blob_store

PG_NO_RIGHT = "42501"  # SQLSTATE insufficient_privilege
OUTAGE_ERRORS = (psycopg.OperationalError, psycopg.InterfaceError, sqlite3.OperationalError)
log = structlog.get_logger()


@contextmanager
def explained_errors() -> Iterator[None]:
    """Turn environmental errors into a TadaError; others are raised unchanged."""
    try:
        yield
    except Exception as error:
        explained = explain_error(error)
        if explained is None or explained is error:
            raise
        raise explained from error


def explain_error(error: BaseException) -> TadaError | None:
    """Return the explanation of an error or of its cause; None if it looks like a bug."""
    if isinstance(error, TadaError):
        return error
    if isinstance(error, sa.exc.TimeoutError):
        return UnavailableError("The database's connections are all in use, for too long.")
    if isinstance(error, sa.exc.DBAPIError):
        is_away = isinstance(error, (sa.exc.OperationalError, sa.exc.InterfaceError))
        return _of_database(error.orig, is_away=is_away, is_full=is_disk_full(error))
    if _sqlite_code(error) == sqlite3.SQLITE_FULL:
        return StorageFullError("The folder for temporary files (TMPDIR) has no room left.")
    if isinstance(error, (psycopg.Error, sqlite3.Error)):
        return _of_database(error, is_away=isinstance(error, OUTAGE_ERRORS), is_full=False)
    if isinstance(error, OSError):
        return _of_system(error)
    return explain_error(error.__cause__) if error.__cause__ is not None else None


def _of_database(error: BaseException | None, *, is_away: bool, is_full: bool) -> TadaError | None:
    text = " ".join(str(error).split())
    if is_full:
        return StorageFullError("The database's disk is full: make room, then try again.")
    if getattr(error, "sqlstate", None) == PG_NO_RIGHT:
        return UnavailableError(
            f"The database denies permission: {text}. The role of TADA_DATABASE_URL must own its database."
        )
    if _sqlite_code(error) in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
        return UnavailableError(
            f"The database's file is damaged, or not ours: {text}. docs/backup.md: restore it."
        )
    # no such table or invalid SQL: reported by the same exception class
    if _sqlite_code(error) == sqlite3.SQLITE_ERROR:
        return None
    return UnavailableError(f"The database does not answer: {text}") if is_away else None


def _of_system(error: OSError) -> TadaError:
    prefix = f"{error.filename}: " if error.filename else ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StorageFullError(f"{prefix}there is no room left.")
    return UnavailableError(f"{prefix}{error.strerror or error}.")


def _sqlite_code(error: BaseException | None) -> int:
    """Return SQLite's primary error code; 0: none."""
    code: int = getattr(error, "sqlite_errorcode", 0)
    return code & 0xFF


def check_stores(settings: Settings) -> None:
    """Raise InvalidInputError, `settings_invalid`, for a wrong key, a missing bucket and the like."""
    blobs = open_blob_store(settings.resolved_blob_url, settings)
    _check("TADA_BLOB_URL", blobs)
    _check("TADA_ERASURE_URL", open_blob_store(settings.resolved_erasure_url, settings))
    if blobs.keeps_versions:  # the ledger may: it names nobody, and is kept
        log.error(
            "store_keeps_versions",
            variable="TADA_BLOB_URL",
            detail="Erased blobs remain in it: docs/storage.md.",
        )


def _check(variable: str, store: BlobStore) -> None:
    try:
        store.check()
        # orphans cannot be deleted with a key that may write but not list
        next(store.keys("nobody/"), None)
    except StoreRefusesError as error:
        raise InvalidInputError(
            f"{variable}, {error.filename}: {error.strerror}.", code="settings_invalid"
        ) from None
    except OSError as error:
        log.warning("store_not_usable", variable=variable, reason=error.strerror)
