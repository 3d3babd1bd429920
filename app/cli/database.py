"""What commands share that need the database: it, opened and up to date; and who runs the command."""

import getpass
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

import app.tables  # noqa: F401  # defines every table
from app.core.settings import Settings

if TYPE_CHECKING:
    from app.db.session import Database

JsonOption = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


@contextmanager
def opened_database() -> Iterator["Database"]:
    """The configured database, up to date, for one command.

    Raises StorageFullError or UnavailableError, in words, where it, its rights, a store or a disk are out of order.
    """
    from app.operations.prepare import prepare

    with database_as_it_is() as database:
        prepare(database, Settings())
        yield database


@contextmanager
def database_as_it_is() -> Iterator["Database"]:
    """The configured database, not migrated, for one command. Raises the same."""
    from app.core.in_words import told_in_words
    from app.db.session import open_database

    with told_in_words():
        database = open_database(Settings())
        try:
            yield database
        finally:
            database.dispose()


def author() -> str:
    """How whoever runs the command stands in the history."""
    return f"command line: {getpass.getuser()}"[:200]
