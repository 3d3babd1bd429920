"""Shared by commands that need the database: open it, read JSON files, name the author of changes."""

import getpass
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.core.errors import InvalidInputError
from app.core.settings import Settings

if TYPE_CHECKING:
    from app.db.session import Database

MAX_JSON_BYTES = 16 * 2**20  # 500 vessels with 200 profile points each are some 3 MB
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


@contextmanager
def opened_database() -> Iterator["Database"]:
    """Open the configured database for one command, and bring it up to date.

    Raises StorageFullError or UnavailableError with a readable message if database, permissions,
    store or disk fail.
    """
    from app.operations.prepare import prepare

    with unmigrated_database() as database:
        prepare(database, Settings())
        yield database


@contextmanager
def unmigrated_database() -> Iterator["Database"]:
    """Open the configured database for one command without migrating it. Raises the same."""
    import app.tables  # noqa: F401  # defines every table
    from app.db.session import open_database
    from app.operations.explain_errors import explained_errors

    with explained_errors():
        database = open_database(Settings())
        try:
            yield database
        finally:
            database.dispose()


def author() -> str:
    """Return the author of a change in the history: the user who runs the command."""
    return f"command line: {getpass.getuser()}"[:200]


def read_json(path: Path) -> object:
    """Return a file's JSON document; - is standard input. Raises InvalidInputError."""
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
