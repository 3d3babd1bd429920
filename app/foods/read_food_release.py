"""Read a published food table from its file, by the name of its format; a csv table needs name, version and date."""

from datetime import date
from pathlib import Path

from app.core.errors import InvalidInputError
from app.foods.importers.csv_table import read_csv_table
from app.foods.importers.fao_density import read_fao_density
from app.foods.importers.fdc import read_fdc
from app.foods.importers.imported import ImportedTable
from app.foods.importers.sr28 import read_sr28
from app.foods.queries import LOCAL

_PUBLISHED = {"sr28": read_sr28, "fdc": read_fdc, "fao-density": read_fao_density}
CSV = "csv"


def read_food_release(
    source: str,
    path: Path,
    *,
    name: str | None = None,
    version: str | None = None,
    released_on: date | None = None,
) -> ImportedTable:
    """Return the whole table, validated. Raises InvalidInputError (ImportFileError for the content of the files)."""
    if source == CSV:
        if name is None or version is None or released_on is None:
            raise InvalidInputError(
                "A csv table needs --name, --version and --released-on: the file does not contain them."
            )
        if name == LOCAL:
            raise InvalidInputError(
                f"{LOCAL!r} is the name of the corrections made here: give the table another one."
            )
        return read_csv_table(path, name=name, version=version, released_on=released_on)
    if source not in _PUBLISHED:
        raise InvalidInputError(
            f"There is no format {source!r}: give one of {', '.join([*_PUBLISHED, CSV])}."
        )
    if any((name, version, released_on)):
        raise InvalidInputError(
            f"{source} states its own name, version and date: leave the options out."
        )
    return _PUBLISHED[source](path)
