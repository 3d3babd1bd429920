"""The files of a release in the making: tables as Parquet and CSV, what they are made of counted on the way.

The caller decides where the files go: into the store for a release, a folder for a comparison. The
checksum of a release is the SHA-256 over the sorted lines `sha256  name` of its files, as sha256sum writes them,
without release.json, which tells who froze it when: the same data frozen twice have one checksum.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from typing import Any, cast

from app.exports.made_file import StagedFile
from app.http.tables.columns import Column, Part, PartOfBatch, Row
from app.http.tables.csv_rows import encode_csv
from app.http.tables.dictionary import DICTIONARY_PARTS, entries
from app.releases.queries import UsedFood

MANIFEST, DICTIONARY = "release.json", "data-dictionary.csv"
FORMAT = 1


@dataclass(frozen=True, slots=True)
class MadeFile:
    """A file of a release. rows: None, it is no table. place: where it was put."""

    name: str
    rows: int | None
    bytes: int
    sha256: str
    place: str


@dataclass(slots=True)
class Contents:
    """What the items of a release are made of. foods: (key, version, table). placed_meals: whose place it holds."""

    pipeline_versions: Counter[str] = field(default_factory=Counter)
    methods: Counter[str] = field(default_factory=Counter)
    food_tables: Counter[str] = field(default_factory=Counter)
    foods: set[UsedFood] = field(default_factory=set)
    placed_meals: int = 0

    def of_table(self, name: str, columns: Sequence[Column], rows: Iterable[Row]) -> Iterable[Row]:
        """The rows of a table, those that count counted on their way."""
        match name:
            case "items":
                return self._tally_items(columns, rows)
            case "meals":
                return self._tally_meals(columns, rows)
            case _:
                return rows

    def _tally_meals(self, columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[Row]:
        latitude = [column.name for column in columns].index("latitude")
        for row in rows:
            self.placed_meals += row[latitude] is not None
            yield row

    def _tally_items(self, columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[Row]:
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

    def told(self) -> dict[str, Any]:
        """As release.json has them: how many items each."""
        return {
            "pipeline_versions": dict(sorted(self.pipeline_versions.items())),
            "methods": dict(sorted(self.methods.items())),
            "food_tables": dict(sorted(self.food_tables.items())),
            "foods": len(self.foods),
            "placed_meals": self.placed_meals,
        }


class ReleaseFiles:
    """Writes the files one after the other.

    new_file: a file to write, gone at its end unless it was kept. keep: name, file -> its place. progress: called with
    the number of rows of each table as they are written.
    """

    def __init__(
        self,
        new_file: Callable[[], AbstractContextManager[StagedFile]],
        keep: Callable[[str, StagedFile], str],
        progress: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.files: dict[str, MadeFile] = {}
        self.columns: dict[str, tuple[Column, ...]] = {}
        self._new_file, self._place, self._progress = new_file, keep, progress

    def add_table(self, name: str, columns: Sequence[Column], rows: Iterable[Row]) -> None:
        """`name`.parquet and `name`.csv."""
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
        """Every column of every table, by the columns that the tables were written by."""
        part = Part("shared", (Column("table", "word", meaning="The table."), *DICTIONARY_PARTS[0].columns))
        rows = [(name, *entry) for name, columns in sorted(self.columns.items()) for entry in entries(columns)]
        with self._new_file() as file:
            file.write_all(encode_csv((part,), [[PartOfBatch(part, rows)]]))
            self._keep(DICTIONARY, file, len(rows))

    def add_manifest(self, told: Mapping[str, Any]) -> dict[str, Any]:
        """release.json: what is told, the files, the tables' columns, the checksum. Returns it."""
        manifest = {
            "format": FORMAT,
            **told,
            "tables": {name: [_column_told(column) for column in columns] for name, columns in self.columns.items()},
            "files": [
                {"name": file.name, "rows": file.rows, "bytes": file.bytes, "sha256": file.sha256}
                for _, file in sorted(self.files.items())
            ],
            "checksum": self.checksum,
        }
        with self._new_file() as file:
            file.write_all([json.dumps(manifest, indent=1, ensure_ascii=False).encode() + b"\n"])
            self._keep(MANIFEST, file, None)
        return manifest

    @property
    def checksum(self) -> str:
        """Over all files but release.json."""
        return checksum_of({file.name: file.sha256 for file in self.files.values()})

    def _keep(self, name: str, file: StagedFile, rows: int | None) -> None:
        length, sha256 = file.length, file.sha256
        self.files[name] = MadeFile(name, rows, length, sha256, self._place(name, file))


def checksum_of(sha256s: Mapping[str, str]) -> str:
    """Of a release whose files have these SHA-256, by name."""
    lines = sorted(f"{sha256}  {name}\n" for name, sha256 in sha256s.items() if name != MANIFEST)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def columns_told(manifest: Mapping[str, Any], table: str) -> tuple[Column, ...]:
    """A table's columns, as its release.json tells them."""
    return tuple(Column(**{**one, "values": tuple(one["values"])}) for one in manifest["tables"][table])


def _column_told(column: Column) -> dict[str, Any]:
    return {**asdict(column), "values": list(column.values)}
