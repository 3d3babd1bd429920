"""Writing the files of a release: tables as Parquet and CSV, the data dictionary, release.json.

The caller decides where the files go: into the store for a release, into a folder for a comparison. The checksum of a
release is the SHA-256 over the sorted lines `sha256  name` of its files, as sha256sum writes them, without
release.json, which has the person and time: the same data frozen twice have the same checksum.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from typing import TypedDict, cast

from pydantic import BaseModel

from app.exports.made_file import StagedFile
from app.http.tables.columns import Column, Part, PartOfBatch, Row
from app.http.tables.csv_rows import encode_csv
from app.http.tables.dictionary import DICTIONARY_PARTS, entries
from app.releases.queries import UsedFood

MANIFEST, DICTIONARY = "release.json", "data-dictionary.csv"
FORMAT = 1


@dataclass(frozen=True, slots=True)
class MadeFile:
    """A file of a release. rows: None if it is no table. place: where it was put."""

    name: str
    rows: int | None
    bytes: int
    sha256: str
    place: str


class Protocol(BaseModel):
    """The part of the study's protocol in release.json that a removal of erased data needs."""

    expects_after_pair: bool


class FormerChecksum(BaseModel):
    """The checksum that a release had until erased data were removed from it."""

    checksum: str
    until: str


class Manifest(BaseModel):
    """The part of release.json that the server reads. tables: name -> columns from left to right."""

    protocol: Protocol
    tables: dict[str, tuple[Column, ...]]
    checksum: str
    altered: list[FormerChecksum]


class ContentsJson(TypedDict):
    """The contents in release.json: numbers of items of each version, method and table; of foods, and placed meals."""

    pipeline_versions: dict[str, int]
    methods: dict[str, int]
    food_tables: dict[str, int]
    foods: int
    placed_meals: int


@dataclass(slots=True)
class Contents:
    """Counts of a release's items by origin. foods: (key, version, table). placed_meals: meals with a place."""

    pipeline_versions: Counter[str] = field(default_factory=Counter)
    methods: Counter[str] = field(default_factory=Counter)
    food_tables: Counter[str] = field(default_factory=Counter)
    foods: set[UsedFood] = field(default_factory=set)
    placed_meals: int = 0

    def count_rows(self, name: str, columns: Sequence[Column], rows: Iterable[Row]) -> Iterable[Row]:
        """Return a table's rows; items and meals are counted while they are read."""
        match name:
            case "items":
                return self._count_items(columns, rows)
            case "meals":
                return self._count_meals(columns, rows)
            case _:
                return rows

    def _count_meals(self, columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[Row]:
        latitude = [column.name for column in columns].index("latitude")
        for row in rows:
            self.placed_meals += row[latitude] is not None
            yield row

    def _count_items(self, columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[Row]:
        place = {column.name: number for number, column in enumerate(columns)}
        run, method = place["pipeline_version"], place["method"]
        key, version, table = place["food_key"], place["food_version"], place["food_table"]
        for row in rows:
            if row[run] is not None:
                self.pipeline_versions[str(row[run])] += 1
                self.methods[str(row[method])] += 1
            if row[key] is not None:
                self.food_tables[str(row[table])] += 1
                self.foods.add(cast("UsedFood", (row[key], row[version], row[table])))
            yield row

    def as_json(self) -> ContentsJson:
        """Return the contents as release.json has them."""
        return {
            "pipeline_versions": dict(sorted(self.pipeline_versions.items())),
            "methods": dict(sorted(self.methods.items())),
            "food_tables": dict(sorted(self.food_tables.items())),
            "foods": len(self.foods),
            "placed_meals": self.placed_meals,
        }


class ReleaseFiles:
    """Writes a release's files one after the other.

    new_file: opens a file that is removed at its end unless it was kept. keep: name, file -> where it was put.
    progress: called with numbers of written rows.
    """

    def __init__(
        self,
        new_file: Callable[[], AbstractContextManager[StagedFile]],
        keep: Callable[[str, StagedFile], str],
        progress: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.files: dict[str, MadeFile] = {}
        self.columns: dict[str, tuple[Column, ...]] = {}
        self._new_file, self._keep_file, self._progress = new_file, keep, progress

    def add_table(self, name: str, columns: Sequence[Column], rows: Iterable[Row]) -> None:
        """Write `name`.parquet and `name`.csv."""
        from app.http.tables.table_files import csv_pieces, parquet_pieces  # noqa: PLC0415  # pyarrow

        count = 0

        def counted() -> Iterator[Row]:
            nonlocal count
            for row in rows:
                count += 1
                if count % 1000 == 0:
                    self._progress(1000)
                yield row

        with self._new_file() as table, self._new_file() as text:
            table.write_all(parquet_pieces(columns, counted()))
            self._progress(count % 1000)
            text.write_all(csv_pieces(columns, table.path))
            self.columns[name] = tuple(columns)
            self._keep(f"{name}.parquet", table, count)
            self._keep(f"{name}.csv", text, count)

    def add_dictionary(self) -> None:
        """Write the dictionary of all columns of the tables that were written."""
        part = Part("shared", (Column("table", "word", meaning="The table."), *DICTIONARY_PARTS[0].columns))
        rows = [(name, *entry) for name, columns in sorted(self.columns.items()) for entry in entries(columns)]
        with self._new_file() as file:
            file.write_all(encode_csv((part,), [[PartOfBatch(part, rows)]]))
            self._keep(DICTIONARY, file, len(rows))

    def add_manifest(self, facts: Mapping[str, object]) -> None:
        """Write release.json: the facts, the tables' columns, the files, the checksum."""
        manifest = {
            "format": FORMAT,
            **facts,
            "tables": {name: [asdict(column) for column in columns] for name, columns in self.columns.items()},
            "files": [
                {"name": file.name, "rows": file.rows, "bytes": file.bytes, "sha256": file.sha256}
                for _, file in sorted(self.files.items())
            ],
            "checksum": self.checksum,
        }
        with self._new_file() as file:
            file.write_all([json.dumps(manifest, indent=1, ensure_ascii=False).encode() + b"\n"])
            self._keep(MANIFEST, file, None)

    @property
    def checksum(self) -> str:
        """The release's checksum, over all files but release.json."""
        return checksum_of({file.name: file.sha256 for file in self.files.values()})

    def _keep(self, name: str, file: StagedFile, rows: int | None) -> None:
        length, sha256 = file.length, file.sha256
        self.files[name] = MadeFile(name, rows, length, sha256, self._keep_file(name, file))


def checksum_of(sha256s: Mapping[str, str]) -> str:
    """Return the checksum of a release. sha256s: by file name."""
    lines = sorted(f"{sha256}  {name}\n" for name, sha256 in sha256s.items() if name != MANIFEST)
    return hashlib.sha256("".join(lines).encode()).hexdigest()
