"""Read a published food table from its file, list the releases, choose the one in force.

A file is read by the name of its format; a csv table needs name, version and date. One row says
which release of a name is in force.
"""

from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from app.core.errors import InvalidInputError, NotFoundError
from app.db.session import Database
from app.foods import queries as foods
from app.foods.importers.csv_table import read_csv_table
from app.foods.importers.fao_density import read_fao_density
from app.foods.importers.fdc import read_fdc
from app.foods.importers.source_files import ImportedTable
from app.foods.importers.sr28 import read_sr28
from app.foods.models import FoodActivation, FoodRelease
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
    """Return the whole table, validated.

    Raises InvalidInputError (ImportFileError for the content of the files).
    """
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


@dataclass(frozen=True, slots=True)
class ListedRelease:
    """A release, and whether it is in force."""

    release: FoodRelease
    is_in_force: bool


def list_releases(database: Database) -> list[ListedRelease]:
    """Return the releases in force in lookup order, then the others, the newest first."""
    with database.read() as session:
        in_force = foods.releases_in_force(session)
        inactive = [release for release in foods.all_releases(session) if release not in in_force]
    return [ListedRelease(release, release in in_force) for release in (*in_force, *inactive)]


def use_release(database: Database, name: str, version: str | None, author: str) -> None:
    """Put the newest import of this version in force, or none of this name.

    Raises NotFoundError.
    """
    with database.write() as session:
        same_name = [release for release in foods.all_releases(session) if release.name == name]
        chosen = [
            release
            for release in same_name
            if release.version == version and release.completed_at is not None
        ]
        if not same_name or (version is not None and not chosen):
            raise NotFoundError(
                f"There is no complete release {name} {version or ''}".rstrip()
                + ": see `tada foods releases`.",
                code="food_release_not_found",
            )
        release_id = chosen[0].id if version is not None else None
        session.add(
            FoodActivation(
                name=name, release_id=release_id, author=author, activated_at=datetime.now(UTC)
            )
        )
