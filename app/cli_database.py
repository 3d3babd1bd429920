"""What commands share that need the database: it, opened and up to date; and who runs the command."""

import getpass
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from app.errors import StorageFullError, UnavailableError
from app.settings import Settings

if TYPE_CHECKING:
    from app.db.session import Database

JsonOption = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


@contextmanager
def opened_database() -> Iterator["Database"]:
    """The configured database, up to date, for one command.

    Raises StorageFullError or UnavailableError, in words, if it has no room or does not answer.
    """
    from app.services.prepare import prepare

    with database_as_it_is() as database:
        prepare(database, Settings())
        yield database


@contextmanager
def database_as_it_is() -> Iterator["Database"]:
    """The configured database, not migrated, for one command. Raises the same."""
    from sqlalchemy.exc import OperationalError

    from app.db.session import is_disk_full, open_database

    database = open_database(Settings())
    try:
        yield database
    except OperationalError as error:
        if is_disk_full(error):
            raise StorageFullError("The database's disk is full: make room, then do the same again.") from error
        raise UnavailableError(f"The database does not answer: {' '.join(str(error.orig).split())}") from error
    finally:
        database.dispose()


def author() -> str:
    """How whoever runs the command stands in the history."""
    return f"command line: {getpass.getuser()}"[:200]
