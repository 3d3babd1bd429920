"""Compares a release with the current data, for `tada releases check`.

The current data are frozen into a temporary folder and compared by checksum, and table by table by
the rows' keys. Nothing is changed.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import duckdb
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.exports.file_task import FileTasks
from app.exports.live_tables import limited_duckdb
from app.exports.release_models import Release
from app.exports.releases import queries as releases
from app.exports.releases.freeze_release import create_view
from app.exports.releases.manifest import Manifest, checksum_of, facts_of
from app.exports.releases.queries import ReleaseRow
from app.exports.releases.release_runner import freeze_request, write_files
from app.exports.releases.releases import CheckedRelease, check_files
from app.exports.releases.tables import FORMER_MANIFEST, KEYS, MANIFEST
from app.meals.stored.receive_photo import sha256_of_file
from app.people import queries as people
from app.storage.blob_store import BlobStore

MOST_LISTED = 10_000
MOST_SECONDS = 6 * 3600.0


@dataclass(frozen=True, slots=True)
class TableDifference:
    """The numbers of rows that are the same, differ in a column, are only in the release, or only in the current data.

    columns: column -> number of rows that differ, including columns that only one of the two has.
    """

    table: str
    same: int
    other: int
    only_frozen: int
    only_now: int
    columns: Mapping[str, int]

    @property
    def is_same(self) -> bool:
        """Whether no row differs."""
        return not (self.other or self.only_frozen or self.only_now)


@dataclass(frozen=True, slots=True)
class Comparison:
    """checked: whether the release's own files are whole. checksum_now: of the current data.

    tables: None if files are damaged or missing; the others are then not compared.
    """

    checked: CheckedRelease
    checksum_now: str
    tables: list[TableDifference] | None

    @property
    def is_reproduced(self) -> bool:
        """Whether freezing now gives the same bytes."""
        return self.checksum_now == self.checked.release.checksum


def compare_release(database: Database, blobs: BlobStore, study_code: str, name: str) -> Comparison:
    """Check a release, and compare it with the current data.

    Raises NotFoundError, ConflictError (`release_not_ready`), OSError.
    """
    with database.read() as session:
        row = _find(session, study_code, name)
    checked = check_files(blobs, row)
    with tempfile.TemporaryDirectory(prefix="made-", dir=blobs.staging_folder()) as folder:
        now, frozen = Path(folder) / "now", Path(folder) / "frozen"
        tables_now = _freeze_now(database, row.release, now)
        checksum_now = checksum_of({path.name: sha256_of_file(path) for path in now.iterdir()})
        if not checked.is_whole:
            return Comparison(checked, checksum_now, None)
        manifest = _fetch(blobs, row, frozen)
        tables = [
            _difference(
                table,
                [column.name for column in columns],
                [column["name"] for column in tables_now.get(table, {"columns": []})["columns"]],
                frozen,
                now,
            )
            for table, columns in manifest.tables.items()
        ]
    return Comparison(checked, checksum_now, tables)


def releases_of_study(database: Database, study_code: str) -> list[Release]:
    """Return a study's releases, the newest first. Raises NotFoundError."""
    with database.read() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError(f"There is no study {study_code!r}.")
        return [
            row.release
            for row in releases.page_of_releases(session, study.id, after=None, limit=MOST_LISTED)
        ]


def _find(session: Session, study_code: str, name: str) -> ReleaseRow:
    study = people.find_study(session, study_code)
    row = releases.find_release(session, study.id, name) if study is not None else None
    if row is None:
        raise NotFoundError(f"Study {study_code!r} has no release {name!r}.")
    if row.release.state not in ("ready", "changing"):
        raise ConflictError(
            f"The release is {row.release.state}, not ready.", code="release_not_ready"
        )
    return row


def _freeze_now(database: Database, release: Release, folder: Path) -> dict[str, Any]:
    """Write the tables as they would be frozen now."""
    folder.mkdir()
    tasks = FileTasks(database, folder.parent, min_free_bytes=0)
    request = freeze_request(release, folder)
    tables: dict[str, Any] = tasks.run("freeze", request, most_seconds=MOST_SECONDS)
    write_files(folder, tables)
    return tables


def _fetch(blobs: BlobStore, row: ReleaseRow, folder: Path) -> Manifest:
    folder.mkdir()
    manifest = MANIFEST
    for file in row.files:
        if not file.name.endswith(".csv"):
            blobs.fetch(file.blob_key, folder / file.name)
        if file.name == FORMER_MANIFEST:
            manifest = FORMER_MANIFEST
    return Manifest.model_validate(facts_of((folder / manifest).read_bytes()))


def _difference(
    table: str, columns: Sequence[str], columns_now: Sequence[str], frozen: Path, now: Path
) -> TableDifference:
    """Compare rows with the same key in the columns that both have; whole rows without a key.

    columns_now: none where the table would not be frozen now.
    """
    common = [name for name in columns if name in columns_now]
    with limited_duckdb(frozen.parent / "spilled") as connection:
        create_view(connection, table, frozen)
        if not columns_now:
            ((rows,),) = connection.execute(f"SELECT count(*) FROM {table}").fetchall()
            return TableDifference(table, 0, 0, rows, 0, dict.fromkeys(columns, rows))
        counts = _counts(connection, table, common, now)
    same, other, only_frozen, only_now, *others = counts
    differing = {name: count for name, count in zip(common, others, strict=True) if count}
    frozen_rows, common_rows = same + other + only_frozen, same + other
    for name in columns:
        if name not in columns_now:
            differing[name] = frozen_rows
    for name in columns_now:
        if name not in columns:
            differing[name] = common_rows + only_now
    return TableDifference(table, same, other, only_frozen, only_now, differing)


def _counts(
    connection: duckdb.DuckDBPyConnection, table: str, common: Sequence[str], now: Path
) -> list[int]:
    """Rows that are the same, others, only frozen, only now; then of each column those that differ."""
    key = KEYS.get(table, tuple(common))
    names = ", ".join(common)
    numbered = (
        f"SELECT {names}, row_number() OVER (PARTITION BY {', '.join(key)}) AS occurrence FROM"
    )
    current = f"read_parquet('{now / table}.parquet')"
    joined = " AND ".join(
        f"frozen.{name} IS NOT DISTINCT FROM now.{name}" for name in (*key, "occurrence")
    )
    differs = [f"frozen.{name} IS DISTINCT FROM now.{name}" for name in common]
    both = "frozen.occurrence IS NOT NULL AND now.occurrence IS NOT NULL"
    some = " OR ".join(differs)
    filters = [
        f"{both} AND NOT ({some})",
        f"{both} AND ({some})",
        "now.occurrence IS NULL",
        "frozen.occurrence IS NULL",
        *(f"{both} AND {differ}" for differ in differs),
    ]
    counts = ", ".join(f"count(*) FILTER ({condition})" for condition in filters)
    (row,) = connection.execute(
        f"SELECT {counts} FROM ({numbered} {table}) frozen FULL JOIN ({numbered} {current}) now ON {joined}"
    ).fetchall()
    return list(row)
