"""The live database as one view per table (views.sql), read by DuckDB in one transaction.

Only in a process that never opens the database by Python's sqlite3: two copies of SQLite in one
process drop each other's locks. So files are made in a process of their own (file_task.py).
"""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import Any

import duckdb
import sqlalchemy as sa
from duckdb.sqltypes import DOUBLE, VARCHAR, DuckDBPyType

from app.diary.study_days import judge_days
from app.nutrition.components import HEADLINES
from app.nutrition.plausible import Plausibility
from app.photos.slots import SLOTS

MEMORY = "400MB"
VIEWS = Path(__file__).parent / "views"
MACROS = (VIEWS / "macros.sql").read_text("utf-8")
HEADLINE = "{headline}"  # a line of views.sql that stands for one of each headline component


@contextmanager
def live_tables(database_url: str, temporary_folder: Path) -> Iterator[duckdb.DuckDBPyConnection]:
    """Attach the database read-only and open a transaction: all that is read is of one moment.

    database_url: of SQLite or PostgreSQL, as SQLAlchemy has it.
    temporary_folder: what does not fit into memory is written here, and removed at the end.
    """
    url = sa.make_url(database_url)
    is_sqlite = url.get_backend_name() == "sqlite"
    with limited_duckdb(temporary_folder) as connection:
        if is_sqlite:
            _attach(connection, "sqlite", str(url.database))
        else:
            if url.password is not None:  # not in the address, which errors quote
                os.environ["PGPASSWORD"] = str(url.password)
            address = sa.URL.create(
                "postgresql", url.username, None, url.host, url.port, url.database, url.query
            )
            _attach(connection, "postgres", address.render_as_string())
        schema = "main" if is_sqlite else "public"
        connection.execute(f"SET search_path = 'memory.main,live.{schema}'")
        connection.execute("SET TimeZone = 'UTC'")
        connection.execute("BEGIN TRANSACTION")
        _create_views(connection, is_sqlite=is_sqlite)
        connection.execute("SELECT count(*) FROM study").fetchall()  # the moment is this
        yield connection


def _attach(connection: duckdb.DuckDBPyConnection, kind: str, place: str) -> None:
    """Attach the database as `live`, by DuckDB's own signed extension, which a package brings."""
    package = Path(str(import_module(f"duckdb_extension_{kind}_scanner").__file__)).parent
    (extension,) = package.glob(f"extensions/*/{kind}_scanner.duckdb_extension")
    connection.load_extension(str(extension))
    connection.execute(f"ATTACH {quoted(place)} AS live (TYPE {kind}, READ_ONLY)")


def _create_views(connection: duckdb.DuckDBPyConnection, *, is_sqlite: bool) -> None:
    for function, kind in ((_energy_to_basal_rate, DOUBLE), (_plausibility, VARCHAR)):
        _add(connection, function, kind)
    dialect = "sqlite.sql" if is_sqlite else "postgresql.sql"
    for text in ((VIEWS / dialect).read_text("utf-8"), MACROS, with_headlines(VIEWS / "views.sql")):
        connection.execute(text)


def _add(
    connection: duckdb.DuckDBPyConnection, function: Callable[..., Any], kind: DuckDBPyType
) -> None:
    """Let SQL call a function of a profile, a day and an energy."""
    name = function.__name__.removeprefix("_")
    parameters: list[Any] = [VARCHAR, VARCHAR, DOUBLE]
    nulls: Any = "special"
    connection.create_function(name, function, parameters, kind, null_handling=nulls)


def limited_duckdb(temporary_folder: Path) -> duckdb.DuckDBPyConnection:
    """A DuckDB that takes one core and little memory; it writes the rest into the folder."""
    return duckdb.connect(
        config={
            "threads": 1,
            "memory_limit": MEMORY,
            "temp_directory": str(temporary_folder),
        }
    )


def with_headlines(path: Path) -> str:
    """A file of SQL, with its lines of a headline component written out for all ten."""
    lines: list[str] = []
    block: list[str] = []
    for line in path.read_text("utf-8").splitlines():
        if HEADLINE in line:
            block.append(line)
            continue
        for headline in HEADLINES:
            lines += [text.replace(HEADLINE, headline.column) for text in block]
        block = []
        lines.append(line.replace("{slots}", str(list(SLOTS))))
    return "\n".join(lines)


def quoted(text: str) -> str:
    """A text as SQL has it."""
    return "'" + text.replace("'", "''") + "'"


def _judge(profile: str | None, day: str, whole_energy_kcal: float | None) -> Plausibility:
    known = json.loads(profile) if profile is not None else None
    is_whole = whole_energy_kcal is not None
    return judge_days(known, date.fromisoformat(day), whole_energy_kcal, int(is_whole))


def _energy_to_basal_rate(
    profile: str | None, day: str, whole_energy_kcal: float | None
) -> float | None:
    return _judge(profile, day, whole_energy_kcal).ratio


def _plausibility(profile: str | None, day: str, whole_energy_kcal: float | None) -> str:
    return _judge(profile, day, whole_energy_kcal).verdict
