"""What commands share that need the database: it, opened and up to date; and who runs the command."""

import getpass
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import app.tables  # noqa: F401  # defines every table
from app.core.errors import InvalidInputError
from app.core.settings import Settings

if TYPE_CHECKING:
    from app.db.session import Database

MAX_JSON_BYTES = 16 * 2**20  # 500 vessels with 200 profile points each are some 3 MB
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
    from app.db.session import open_database
    from app.operations.in_words import told_in_words

    with told_in_words():
        database = open_database(Settings())
        try:
            yield database
        finally:
            database.dispose()


def author() -> str:
    """How whoever runs the command stands in the history."""
    return f"command line: {getpass.getuser()}"[:200]


def read_json(path: Path) -> object:
    """A JSON document of a file; - stands for standard input. Raises InvalidInputError."""
    try:
        with nullcontext(sys.stdin.buffer) if str(path) == "-" else path.open("rb") as file:
            content = file.read(MAX_JSON_BYTES + 1)
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read: {error.strerror}.") from None
    if len(content) > MAX_JSON_BYTES:
        raise InvalidInputError(f"{path} is larger than {MAX_JSON_BYTES} bytes, the limit.")
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{path} is not JSON: {error}.") from None
