"""Import Open Food Facts' dump: its labels are checked in DuckDB (read_dump.sql) and refused with a reason.

The dump is `en.openfoodfacts.org.products.csv`, also with `.gz`: fields between tabs, without
quotes. Its rows stay in a table of their own: three million foods would be most of what a search of
the food tables finds. A product that is eaten becomes a food (packaged_foods.py).
"""

import hashlib
import tempfile
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import duckdb
import sqlalchemy as sa

from app.db.bulk import insert_rows
from app.db.session import Database
from app.foods.import_foods import (
    FOOD_TABLES,
    Batch,
    ImportReport,
    Progress,
    component_ids,
    run_import,
)
from app.foods.importers.source_files import ImportedTable, ImportFileError, Skipped
from app.foods.models import FoodRelease
from app.foods.packaged.models import PackagedFood
from app.foods.packaged.packaged_foods import adopt_again
from app.foods.queries import OPEN_FOOD_FACTS
from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.foods import FoodTable

NAME = "open-food-facts"
LABEL_COMPONENTS = ("208", "203", "204", "606", "205", "CHOAVL", "269", "291", "307")
BATCH_ROWS = 4000
# memory_limit: of DuckDB, which sorts the rest on disk; Python takes as much again
LIMITS: dict[str, str | bool | int | float | list[str]] = {
    "threads": 1,
    "memory_limit": "64MB",
    "preserve_insertion_order": False,
}
READ_DUMP = Path(__file__).parent / "read_dump.sql"


def import_packaged(
    database: Database, path: Path, author: str, on_progress: Progress
) -> tuple[ImportedTable, ImportReport]:
    """Write a dump in place of the previous one; return its release, with what was refused, and the figures.

    Raises ImportFileError, ConflictError.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        duckdb.connect(f"{folder}/dump.duckdb", config=LIMITS) as connection,
    ):
        imported, foods, values = _read_dump(connection, path)

        def batches(release: FoodRelease, _: int) -> Iterator[Batch]:
            component_ids(database, imported)
            written = sa.select(sa.func.count(), sa.func.max(PackagedFood.code))
            with database.read() as session:
                done, last = session.execute(written.filter_by(release_id=release.id)).one()
            rows = connection.execute(
                "SELECT ? AS release_id, * FROM sound WHERE code > ? ORDER BY code",
                [release.id, last or 0],
            )
            names = [name for name, *_ in rows.description]
            while batch := [
                dict(zip(names, row, strict=True)) for row in rows.fetchmany(BATCH_ROWS)
            ]:
                yield partial(insert_rows, model=PackagedFood, rows=batch)
                done += len(batch)
                on_progress(done, foods)
            yield partial(adopt_again, release=release)

        tables = (PackagedFood, *FOOD_TABLES)
        was_there = run_import(database, imported, author, batches, tables)
    _remove_others(database, imported.table.checksum)
    return imported, ImportReport(foods, values, was_there)


def _read_dump(connection: duckdb.DuckDBPyConnection, path: Path) -> tuple[ImportedTable, int, int]:
    """Return the release, its foods and their figures; the foods are in the table `sound`."""
    try:
        with path.open("rb") as file:
            checksum = hashlib.file_digest(file, "sha256").hexdigest()
        connection.execute("SET VARIABLE dump = ?", [str(path)])
        connection.execute(READ_DUMP.read_text("utf-8"))
    except (OSError, duckdb.Error) as error:
        raise ImportFileError(str(path), None, f"it is no dump that can be read: {error}") from None
    refused = connection.execute("FROM refused").fetchall()
    skipped = Skipped(
        Counter({reason: count for reason, count, _ in refused}),
        {reason: examples for reason, _, examples in refused},
    )
    ((foods, values, modified_at),) = connection.execute("FROM figures").fetchall()
    if not foods:
        raise ImportFileError(
            str(path), None, f"it has no sound row: {'; '.join(skipped.sentences())}"
        )
    day = datetime.fromtimestamp(modified_at, UTC).date()
    table = FoodTable(NAME, day.isoformat(), day, checksum, ())
    components = tuple(COMPONENT_BY_NUMBER[number] for number in LABEL_COMPONENTS)
    return ImportedTable(OPEN_FOOD_FACTS, table, components, skipped), foods, values


def _remove_others(database: Database, checksum: str) -> None:
    """Delete the rows of other dumps, and end their imports.

    Until one of them is imported again, it cannot be put in force.
    """
    is_other = (FoodRelease.source == OPEN_FOOD_FACTS, FoodRelease.checksum != checksum)
    place = sa.tuple_(PackagedFood.release_id, PackagedFood.code)
    releases = sa.select(FoodRelease.id).where(*is_other)
    rows = sa.select(PackagedFood.release_id, PackagedFood.code).where(
        PackagedFood.release_id.in_(releases)
    )
    removal = sa.delete(PackagedFood).where(place.in_(rows.limit(BATCH_ROWS)))
    ended = dict.fromkeys(("completed_at", "written_at", "importer_id"))
    with database.write() as session:
        session.execute(sa.update(FoodRelease).where(*is_other).values(**ended))
    are_left = True
    while are_left:
        with database.write() as session:
            are_left = bool(session.scalars(removal.returning(PackagedFood.code)).all())
