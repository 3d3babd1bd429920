"""Compares a release with the current data, for `tada releases check`.

The current data are frozen into a temporary folder and compared by checksum, and table by table by the rows' keys.
Nothing is changed. Large tables are compared in parts, chosen by the keys' hashes. The files' order cannot be used for
that: the ids of anonymised participants changed, their places did not.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.exports.made_file import StagedFile, long_snapshot, staged_file
from app.exports.release_models import Release
from app.http.tables.columns import Column, Row
from app.people import queries as people
from app.people.models import Study
from app.releases import queries as releases
from app.releases.freeze_release import filters_of_json, freeze
from app.releases.queries import ReleaseRow
from app.releases.release_files import MANIFEST, Manifest, ReleaseFiles
from app.releases.releases import CheckedRelease, check_files
from app.storage.blob_store import BlobStore

KEYS: Mapping[str, tuple[str, ...]] = {
    "items": ("id",),
    "meals": ("participant", "meal_id"),
    "days": ("participant", "local_date"),
    "photographs": ("participant", "meal_id", "slot"),
    "participants": ("participant",),
    "foods": ("food_key", "food_version", "food_table"),
    "food_nutrients": ("food_key", "food_version", "food_table", "number"),
}
ROWS_AT_A_TIME = 200_000  # in memory; the files are read once per part
MOST_LISTED = 10_000


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
        now = _freeze_now(database, row.release, Path(folder) / "now")
        if not checked.is_whole:
            return Comparison(checked, now.checksum, None)
        frozen = _fetch(blobs, row, Path(folder) / "frozen")
        manifest = Manifest.model_validate_json((frozen / MANIFEST).read_bytes())
        tables = [
            _difference(table, columns, frozen, now.columns.get(table, ()), Path(folder) / "now")
            for table, columns in manifest.tables.items()
        ]
    return Comparison(checked, now.checksum, tables)


def releases_of_study(database: Database, study_code: str) -> list[Release]:
    """Return a study's releases, the newest first. Raises NotFoundError."""
    with database.read() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError(f"There is no study {study_code!r}.")
        return [row.release for row in releases.page_of_releases(session, study.id, after=None, limit=MOST_LISTED)]


def _find(session: Session, study_code: str, name: str) -> ReleaseRow:
    study = people.find_study(session, study_code)
    row = releases.find_release(session, study.id, name) if study is not None else None
    if row is None:
        raise NotFoundError(f"Study {study_code!r} has no release {name!r}.")
    if row.release.state not in ("ready", "changing"):  # a changing release may wait for a missing file
        raise ConflictError(f"The release is {row.release.state}, not ready.", code="release_not_ready")
    return row


def _freeze_now(database: Database, release: Release, folder: Path) -> ReleaseFiles:
    folder.mkdir()

    def keep(name: str, file: StagedFile) -> str:
        file.path.rename(folder / name)
        return name

    files = ReleaseFiles(lambda: staged_file(folder, lambda _: None, 0), keep)
    with long_snapshot(database) as session:
        study = session.get_one(Study, release.study_id)
        freeze(session, study.id, study.code, filters_of_json(release.filters), files)
    return files


def _fetch(blobs: BlobStore, row: ReleaseRow, folder: Path) -> Path:
    folder.mkdir()
    for file in row.files:
        if file.name == MANIFEST or file.name.endswith(".parquet"):
            blobs.fetch(file.blob_key, folder / file.name)
    return folder


def _difference(
    table: str, columns: Sequence[Column], frozen: Path, columns_now: Sequence[Column], now: Path
) -> TableDifference:
    """Compare rows with the same key in the columns that both have; whole rows in a table without keys."""
    current = {column.name: column for column in columns_now}
    common = [column for column in columns if column.name in current]
    names = [column.name for column in common]
    before = _Table(frozen / f"{table}.parquet", common, KEYS.get(table))
    after = (
        _Table(now / f"{table}.parquet", [current[name] for name in names], KEYS.get(table)) if columns_now else None
    )
    parts = 1 + max(side.count() for side in (before, after) if side is not None) // ROWS_AT_A_TIME
    sums, by_column = Counter[str](), Counter[str]()
    for part in range(parts):
        old_rows = dict(before.rows(part, parts))
        for key, row in after.rows(part, parts) if after is not None else ():
            old = old_rows.pop(key, None)
            sums["only_now" if old is None else "same" if old == row else "other"] += 1
            if old is not None and old != row:
                by_column.update(name for name, was, value in zip(names, old, row, strict=True) if was != value)
        sums["only_frozen"] += len(old_rows)
    frozen_rows, common_rows = sums["same"] + sums["other"] + sums["only_frozen"], sums["same"] + sums["other"]
    frozen_names = {column.name for column in columns}
    differing = (
        dict(by_column)
        | {column.name: frozen_rows for column in columns if column.name not in current}
        | {name: common_rows + sums["only_now"] for name in current if name not in frozen_names}
    )
    return TableDifference(table, sums["same"], sums["other"], sums["only_frozen"], sums["only_now"], differing)


@dataclass(frozen=True, slots=True)
class _Table:
    """A Parquet file of these columns. keys: columns that identify a row; None: all columns, and their occurrence."""

    path: Path
    columns: Sequence[Column]
    keys: tuple[str, ...] | None

    def count(self) -> int:
        """Return the number of rows."""
        from app.http.tables.table_files import count_rows  # noqa: PLC0415  # pyarrow

        return count_rows(self.path)

    def rows(self, part: int, parts: int) -> Iterator[tuple[Row, Row]]:
        """Yield (key, row) of a part; equal keys are in the same part of each table."""
        from app.http.tables.table_files import read_rows  # noqa: PLC0415  # pyarrow

        names = [column.name for column in self.columns]
        places = [names.index(name) for name in (names if self.keys is None else self.keys)]
        occurrences = Counter[Row]()
        for row in read_rows(self.columns, self.path):
            key = tuple(row[place] for place in places)
            if hash(key) % parts != part:
                continue
            if self.keys is None:
                occurrences[key] += 1
                key = (*key, occurrences[key])
            yield key, row
