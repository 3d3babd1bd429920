"""What keeps a command, a server or a worker from its work, as a sentence: database, store or disk, rights, room.

Faults of the surroundings only, which whoever runs the program can mend. What looks like a fault of the program keeps
its traceback, for those who mend that.
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
AWAY = (psycopg.OperationalError, psycopg.InterfaceError, sqlite3.OperationalError)


@contextmanager
def explained_errors() -> Iterator[None]:
    """Such faults become a TadaError; others stay what they are."""
    try:
        yield
    except Exception as error:
        told = in_words(error)
        if told is None or told is error:
            raise
        raise told from error


def in_words(error: BaseException) -> TadaError | None:
    """The sentence; None: it tells of the program. What others wrap and name as their cause is looked into."""
    if isinstance(error, TadaError):
        return error
    if isinstance(error, sa.exc.TimeoutError):
        return UnavailableError("The database's connections are all in use, for too long.")
    if isinstance(error, sa.exc.DBAPIError):
        is_away = isinstance(error, (sa.exc.OperationalError, sa.exc.InterfaceError))
        return _of_database(error.orig, is_away=is_away, is_full=is_disk_full(error))
    if _sqlite_code(error) == sqlite3.SQLITE_FULL:
        return StorageFullError("The folder for temporary files (TMPDIR) has no room left.")  # app/db/scratch_keys.py
    if isinstance(error, (psycopg.Error, sqlite3.Error)):
        return _of_database(error, is_away=isinstance(error, AWAY), is_full=False)
    if isinstance(error, OSError):
        return _of_system(error)
    return in_words(error.__cause__) if error.__cause__ is not None else None


def _of_database(error: BaseException | None, *, is_away: bool, is_full: bool) -> TadaError | None:
    said = " ".join(str(error).split())
    if is_full:
        return StorageFullError("The database's disk is full: make room, then do the same again.")
    if getattr(error, "sqlstate", None) == PG_NO_RIGHT:
        return UnavailableError(
            f"The database does not let us: {said}. The role of TADA_DATABASE_URL must own its database."
        )
    if _sqlite_code(error) in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
        return UnavailableError(f"The database's file is damaged, or none of ours: {said}. docs/backup.md: restore it.")
    if _sqlite_code(error) == sqlite3.SQLITE_ERROR:  # no such table, no statement: in a class with what is away
        return None
    return UnavailableError(f"The database does not answer: {said}") if is_away else None


def _of_system(error: OSError) -> TadaError:
    where = f"{error.filename}: " if error.filename else ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StorageFullError(f"{where}there is no room left.")
    return UnavailableError(f"{where}{error.strerror or error}.")


def _sqlite_code(error: BaseException | None) -> int:
    """SQLite's primary code; 0: none."""
    code: int = getattr(error, "sqlite_errorcode", 0)
    return code & 0xFF
