"""Import a published food table: write it inactive in short batches, then put it in force by one row.

Uploads and workers continue meanwhile: a batch locks the database for a tenth of a second, and
pauses before the next one. Importing the same files again resumes an interrupted import; a release
that was never in force is not visible. Importing files that are in force already changes nothing.
"""

import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from functools import partial

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError
from app.db.base import Base
from app.db.bulk import insert_rows, refresh_statistics
from app.db.session import Database
from app.foods import queries as foods
from app.foods.component_names import component_row
from app.foods.importers.source_files import ImportedTable, Skipped
from app.foods.models import (
    Food,
    FoodActivation,
    FoodDensity,
    FoodNutrient,
    FoodPortion,
    FoodRelease,
)
from app.foods.search.models import FoodCode, FoodPosting
from app.foods.search.queries import index_foods, is_code
from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.foods import Food as FoodValue
from app.nutrition.foods import load_starter_table, starter_checksum
from app.nutrition.search import label_key

BATCH_FOODS = 50
# SQLite has one writer at a time: a pause of this share of a batch's duration leaves other writers
# a third of the time.
PAUSE_SHARE = 0.5
# an importer without a batch for this long counts as dead; another may resume
ABANDONED_AFTER = timedelta(seconds=60)


@dataclass(frozen=True, slots=True)
class ImportReport:
    """Result of an import.

    was_there: the same files had been imported before, and nothing was written.
    """

    foods: int
    values: int
    was_there: bool


Progress = Callable[[int, int], None]  # foods written, foods in all
Batch = Callable[[Session], object]
FOOD_TABLES = (Food, FoodNutrient, FoodDensity, FoodPortion, FoodCode, FoodPosting)


def import_foods(
    database: Database, imported: ImportedTable, author: str, on_progress: Progress | None = None
) -> ImportReport:
    """Write the table and put it in force in place of the previous release of the same name.

    Raises ConflictError while another process imports the same files.
    """
    table = imported.table

    def batches(release: FoodRelease, done: int) -> Iterator[Batch]:
        ids = component_ids(database, imported)
        for start in range(done, len(table.foods), BATCH_FOODS):
            batch = table.foods[start : start + BATCH_FOODS]
            yield partial(write_foods, release=release, values=batch, component_ids=ids)
            if on_progress is not None:
                on_progress(start + len(batch), len(table.foods))

    was_there = run_import(database, imported, author, batches, FOOD_TABLES)
    return ImportReport(
        len(table.foods), sum(len(food.per_100_g) for food in table.foods), was_there
    )


def run_import(
    database: Database,
    imported: ImportedTable,
    author: str,
    batches: Callable[[FoodRelease, int], Iterable[Batch]],
    tables: Sequence[type[Base]],
) -> bool:
    """Write a release in short transactions and put it in force; return whether it was there before.

    batches: from the release and the number of its foods that are written, what each transaction
    writes. tables: those that it fills. Raises ConflictError while another process imports the same
    files.
    """
    importer_id = uuid.uuid4()
    try:
        with database.write() as session:
            release, done = _begin(session, imported, importer_id)
    except IntegrityError:  # another process began at the same moment
        raise _running() from None
    was_there = release.completed_at is not None
    if not was_there:
        try:
            for write in batches(release, done):
                began = time.monotonic()
                with database.write() as session:
                    _claim(session, release.id, importer_id)
                    write(session)
                if database.is_sqlite:
                    time.sleep(PAUSE_SHARE * (time.monotonic() - began))
        except BaseException:  # Ctrl-C too: the next importer need not wait
            _release_import(database, release.id, importer_id)
            raise
    with database.write() as session:
        _put_in_force(session, session.get_one(FoodRelease, release.id), author)
        if not was_there:
            refresh_statistics(session, tables)
    return was_there


def load_starter(database: Database) -> None:
    """Load the table in the package unless this version is loaded; one transaction, since the table is small.

    Safe when two processes do it at once: the second one finds the first one's release.
    """
    if is_starter_there(database):
        return
    table = load_starter_table()
    components = tuple(
        COMPONENT_BY_NUMBER[number]
        for number in sorted({n for f in table.foods for n in f.per_100_g})
    )
    imported = ImportedTable("starter", table, components, Skipped())
    try:
        ids = component_ids(database, imported)
        with database.write() as session:
            if foods.release_by_checksum(session, table.checksum) is not None:
                return
            release, _ = _begin(session, imported, None)
            write_foods(session, release, table.foods, ids)
            _put_in_force(session, release, "tada")
    except IntegrityError:
        if not is_starter_there(database):
            raise


def is_starter_there(database: Database) -> bool:
    """Return whether this version of the table in the package has been loaded."""
    with database.read() as session:
        return foods.release_by_checksum(session, starter_checksum()) is not None


def write_food(
    session: Session, release: FoodRelease, value: FoodValue, *, version: int = 1
) -> Food:
    """Insert one food of a release with its nutrients, densities and portions; its components must exist."""
    ids = {
        number: component.id for number, component in foods.components_by_number(session).items()
    }
    return write_foods(session, release, [value], ids, version=version)[0]


def _begin(
    session: Session, imported: ImportedTable, importer_id: uuid.UUID | None
) -> tuple[FoodRelease, int]:
    """Return the release to write into, and how many of its foods are written already."""
    table, now = imported.table, datetime.now(UTC)
    release = foods.release_by_checksum(session, table.checksum, lock=True)
    if release is None:
        release = FoodRelease(
            source=imported.source,
            name=table.name,
            version=table.version,
            released_on=table.released_on,
            checksum=table.checksum,
            imported_at=now,
            importer_id=importer_id,
            written_at=now,
        )
        session.add(release)
        session.flush()
        return release, 0
    if release.completed_at is not None:
        return release, len(table.foods)
    if release.written_at is not None and now - release.written_at < ABANDONED_AFTER:
        raise _running()
    release.importer_id, release.written_at = importer_id, now
    written = session.scalar(sa.select(sa.func.count()).where(Food.release_id == release.id))
    return release, int(written or 0)


def _running() -> ConflictError:
    return ConflictError(
        "These files are being imported by another process at this moment; if that one has died, try again in "
        f"{int(ABANDONED_AFTER.total_seconds())} seconds.",
        code="food_import_running",
    )


def _claim(session: Session, release_id: int, importer_id: uuid.UUID) -> None:
    """Record that the import is alive.

    Raises ConflictError if another importer has taken it over.
    """
    claimed = session.execute(
        sa.update(FoodRelease)
        .where(FoodRelease.id == release_id, FoodRelease.importer_id == importer_id)
        .values(written_at=datetime.now(UTC))
        .returning(FoodRelease.id)
    )
    if claimed.scalar_one_or_none() is None:
        raise ConflictError(
            "Another process has taken over this import.", code="food_import_running"
        )


def _release_import(database: Database, release_id: int, importer_id: uuid.UUID) -> None:
    with database.write() as session:
        session.execute(
            sa.update(FoodRelease)
            .where(FoodRelease.id == release_id, FoodRelease.importer_id == importer_id)
            .values(importer_id=None, written_at=None)
        )


def _put_in_force(session: Session, release: FoodRelease, author: str) -> None:
    now = datetime.now(UTC)
    if release.completed_at is None:
        release.completed_at, release.importer_id = now, None
    if release.id not in {active.id for active in foods.releases_in_force(session)}:
        session.add(
            FoodActivation(
                name=release.name, release_id=release.id, author=author, activated_at=now
            )
        )


def component_ids(database: Database, imported: ImportedTable) -> dict[str, int]:
    """Return number -> id of all components, after adding those of the table that are missing.

    Two imports may add the same component at once: the second one retries and finds it.
    """
    for attempt in range(2):
        try:
            with database.write() as session:
                existing = foods.components_by_number(session)
                missing = [
                    component
                    for component in imported.components
                    if component.number not in existing
                ]
                session.add_all(map(component_row, missing))
                session.flush()
                return {
                    number: component.id
                    for number, component in foods.components_by_number(session).items()
                }
        except IntegrityError:
            if attempt:
                raise
    raise AssertionError


def write_foods(
    session: Session,
    release: FoodRelease,
    values: Sequence[FoodValue],
    component_ids: dict[str, int],
    *,
    version: int = 1,
) -> list[Food]:
    """Insert foods of a release with what belongs to them; their components must exist."""
    rows = [_food_row(release.id, value, version) for value in values]
    pairs = list(zip(rows, values, strict=True))
    session.add_all(rows)
    session.flush()
    insert_rows(
        session,
        FoodNutrient,
        [
            {"food_id": row.id, "component_id": component_ids[number], "per_100_g": content}
            for row, value in pairs
            for number, content in value.per_100_g.items()
        ],
    )
    for model, parts in ((FoodDensity, "densities"), (FoodPortion, "portions")):
        insert_rows(
            session,
            model,
            [
                {"food_id": row.id, "position": position, **asdict(part)}
                for row, value in pairs
                for position, part in enumerate(getattr(value, parts))
            ],
        )
    insert_rows(session, FoodCode, [code for row in rows for code in _codes(row, release.source)])
    if release.source != foods.DENSITIES_ONLY:
        index_foods(session, rows)
    return rows


def _food_row(release_id: int, value: FoodValue, version: int) -> Food:
    copied = ("key", "name", "food_group", "form", "slice_form", "state", "is_mixed_dish")
    return Food(
        release_id=release_id,
        version=version,
        **{name: getattr(value, name) for name in copied},
        aliases=list(value.aliases),
        refuse=[asdict(part) for part in value.refuse],
        probes=list(value.probes),
        source_ids=dict(value.source_ids),
    )


def _codes(row: Food, source: str) -> list[dict[str, object]]:
    codes = [
        {"system": system, "code": str(code), "food_id": row.id}
        for system, code in row.source_ids.items()
        if is_code(system)
    ]
    if source == foods.DENSITIES_ONLY:
        codes.append({"system": "label", "code": label_key(row.name)[:300], "food_id": row.id})
    return codes
