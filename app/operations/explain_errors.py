"""Explain environmental errors in a sentence: database, store or disk unavailable, full, or without permission.

Only for errors that an operator can fix. Errors that look like bugs keep their traceback.
"""

import errno
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

import psycopg
import sqlalchemy as sa

from app.core.errors import StorageFullError, TadaError, UnavailableError
from app.db.session import is_disk_full

PG_NO_RIGHT = "42501"  # SQLSTATE insufficient_privilege
OUTAGE_ERRORS = (psycopg.OperationalError, psycopg.InterfaceError, sqlite3.OperationalError)


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
    if (
        _sqlite_code(error) == sqlite3.SQLITE_ERROR
    ):  # no such table or invalid SQL: reported by the same exception class
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
