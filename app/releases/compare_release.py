"""Would freezing the same filters now give the same release? Row by row, where not: for `tada releases check`.

The data of now are written as a release would be, into a folder that goes, and compared: by checksum, and table by
table by the rows' own keys. Nothing is changed. Of a large table some rows at a time are held, as their keys' hashes
choose them: the files' order does not serve, since of whom a name was taken the ids changed and the places did not.
"""

import json
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
from app.releases.queries import NamedRelease
from app.releases.release_files import MANIFEST, ReleaseFiles, columns_told
from app.releases.releases import CheckedRelease, check_files
from app.storage.blob_store import BlobStore

KEYS: Mapping[str, tuple[str, ...]] = {
    "items": ("id",),
    "meals": ("participant", "meal_id"),
    "days": ("participant", "local_date"),
    "photographs": ("participant", "meal_id", "slot"),
    "foods": ("food_key", "food_version", "food_table"),
    "food_nutrients": ("food_key", "food_version", "food_table", "number"),
}
ROWS_AT_A_TIME = 200_000  # in memory; the files are read as often as it takes
MOST_LISTED = 10_000


@dataclass(frozen=True, slots=True)
class TableDifference:
    """A table's rows: the same, other in a column, only in the release, only in the data of now.

    columns: how many rows differ in each; those that only one of the two has are told by their names.
    """

    table: str
    same: int
    other: int
    only_frozen: int
    only_now: int
    columns: Mapping[str, int]

    @property
    def is_same(self) -> bool:
        """No row differs."""
        return not (self.other or self.only_frozen or self.only_now)


@dataclass(frozen=True, slots=True)
class Comparison:
    """checked: whether the release's own files are whole. checksum_now: that of the data of now.

    tables: None where files are lost: what is left of them is not compared.
    """

    checked: CheckedRelease
    checksum_now: str
    tables: list[TableDifference] | None

    @property
    def is_reproduced(self) -> bool:
        """Frozen now it would be the same, byte for byte."""
        return self.checksum_now == self.checked.release.checksum


def compare_release(database: Database, blobs: BlobStore, study_code: str, name: str) -> Comparison:
    """Check a release, and compare it with the data of now.

    Raises NotFoundError, ConflictError (`release_not_ready`), OSError.
    """
    with database.read() as session:
        found = _find(session, study_code, name)
    checked = check_files(blobs, found)
    with tempfile.TemporaryDirectory(prefix="made-", dir=blobs.staging_folder()) as folder:
        now = _freeze_now(database, found, Path(folder) / "now")
        if not checked.is_whole:
            return Comparison(checked, now.checksum, None)
        frozen = _fetch(blobs, found, Path(folder) / "frozen")
        manifest = json.loads((frozen / MANIFEST).read_bytes())
        tables = [
            _difference(table, columns_told(manifest, table), frozen, now.columns.get(table, ()), Path(folder) / "now")
            for table in manifest["tables"]
        ]
    return Comparison(checked, now.checksum, tables)


def releases_of_study(database: Database, study_code: str) -> list[Release]:
    """The newest first. Raises NotFoundError."""
    with database.read() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError(f"There is no study {study_code!r}.")
        return [row.release for row in releases.page_of_releases(session, study.id, after=None, limit=MOST_LISTED)]


def _find(session: Session, study_code: str, name: str) -> NamedRelease:
    study = people.find_study(session, study_code)
    found = releases.find_release(session, study.id, name) if study is not None else None
    if found is None:
        raise NotFoundError(f"Study {study_code!r} has no release {name!r}.")
    if found.release.state not in ("ready", "changing"):  # one that changes may wait for a file that is lost
        raise ConflictError(f"The release is {found.release.state}, not ready.", code="release_not_ready")
    return found


def _freeze_now(database: Database, found: NamedRelease, folder: Path) -> ReleaseFiles:
    folder.mkdir()

    def keep(name: str, file: StagedFile) -> str:
        file.path.rename(folder / name)
        return name

    files = ReleaseFiles(lambda: staged_file(folder, lambda _: None, 0), keep)
    with long_snapshot(database) as session:
        study = session.get_one(Study, found.release.study_id)
        freeze(session, study.id, study.code, filters_of_json(found.release.filters), files)
    return files


def _fetch(blobs: BlobStore, found: NamedRelease, folder: Path) -> Path:
    folder.mkdir()
    for file in found.files:
        if file.name == MANIFEST or file.name.endswith(".parquet"):
            blobs.fetch(file.blob_key, folder / file.name)
    return folder


def _difference(
    table: str, columns: Sequence[Column], frozen: Path, columns_now: Sequence[Column], now: Path
) -> TableDifference:
    """Of rows that have the same key, in the columns that both have; a table without keys by whole rows."""
    of_now = {column.name: column for column in columns_now}
    both = [column for column in columns if column.name in of_now]
    names = [column.name for column in both]
    before = _Table(frozen / f"{table}.parquet", both, KEYS.get(table))
    after = _Table(now / f"{table}.parquet", [of_now[name] for name in names], KEYS.get(table)) if columns_now else None
    parts = 1 + max(one.count() for one in (before, after) if one is not None) // ROWS_AT_A_TIME
    sums, by_column = Counter[str](), Counter[str]()
    for part in range(parts):
        old = dict(before.rows(part, parts))
        for key, row in after.rows(part, parts) if after is not None else ():
            was = old.pop(key, None)
            sums["only_now" if was is None else "same" if was == row else "other"] += 1
            if was is not None and was != row:
                by_column.update(name for name, one, other in zip(names, was, row, strict=True) if one != other)
        sums["only_frozen"] += len(old)
    of_frozen, of_both = sums["same"] + sums["other"] + sums["only_frozen"], sums["same"] + sums["other"]
    known = {column.name for column in columns}
    differing = (
        dict(by_column)
        | {column.name: of_frozen for column in columns if column.name not in of_now}
        | {name: of_both + sums["only_now"] for name in of_now if name not in known}
    )
    return TableDifference(table, sums["same"], sums["other"], sums["only_frozen"], sums["only_now"], differing)


@dataclass(frozen=True, slots=True)
class _Table:
    """A Parquet file of these columns. keys: by which its rows are known; None: by all they say, and how often."""

    path: Path
    columns: Sequence[Column]
    keys: tuple[str, ...] | None

    def count(self) -> int:
        """How many rows it has."""
        from app.http.tables.table_files import count_rows  # noqa: PLC0415  # pyarrow

        return count_rows(self.path)

    def rows(self, part: int, parts: int) -> Iterator[tuple[Row, Row]]:
        """(key, row) of one of so many parts: the same keys are in the same part of each table."""
        from app.http.tables.table_files import read_rows  # noqa: PLC0415  # pyarrow

        names = [column.name for column in self.columns]
        places = [names.index(name) for name in (names if self.keys is None else self.keys)]
        alike = Counter[Row]()
        for row in read_rows(self.columns, self.path):
            key = tuple(row[place] for place in places)
            if hash(key) % parts != part:
                continue
            if self.keys is None:
                alike[key] += 1
                key = (*key, alike[key])
            yield key, row
