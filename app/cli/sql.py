"""The command `tada sql`: a query over the tables that exports have."""

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer


def sql(
    query: Annotated[str, typer.Argument(metavar="QUERY", help="A SELECT, in DuckDB's SQL.")],
    study: Annotated[
        str | None, typer.Option("--study", metavar="CODE", help="Only this study's rows.")
    ] = None,
) -> None:
    """Query records, meals, days, photographs, participants and components; nothing is changed.

    A table on a terminal, CSV elsewhere. The columns are those of the data dictionary.
    """
    import duckdb

    from app.core.errors import InvalidInputError
    from app.core.settings import Settings
    from app.exports.live_tables import live_tables
    from app.exports.table_selects import show_tables

    url = Settings().resolved_database_url
    with TemporaryDirectory() as folder:
        try:
            with live_tables(url, Path(folder)) as connection:
                show_tables(connection, study)
                rows = connection.sql(query)
                if rows is not None and sys.stdout.isatty():
                    rows.show()
                elif rows is not None:
                    path = Path(folder) / "rows.csv"
                    rows.write_csv(str(path))
                    with path.open("rb") as file:
                        shutil.copyfileobj(file, sys.stdout.buffer)
        except duckdb.Error as error:
            raise InvalidInputError(str(error)) from None
