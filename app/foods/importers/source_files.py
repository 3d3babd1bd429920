"""What an importer reads, a release's files, and what it gives: a validated table.

A release is a zip or a folder: numbered lines, and the same checksum for either. Errors in a file
raise ImportFileError with the file and, if there is one, the line. The table is complete; what was
left out of it is counted with reasons.
"""

import csv
import hashlib
import math
import re
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Container, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, NamedTuple

from app.core.errors import InvalidInputError
from app.core.units import Unit, UnitMismatchError, convert
from app.nutrition.components import COMPONENT_BY_NUMBER, Component
from app.nutrition.foods import FoodTable

_CHUNK = 1 << 20

# Stricter than float(), which accepts 1_000, inf, nan and the digits of other scripts.
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*\Z", re.ASCII)

# Errors that zipfile raises on damaged files: its own, and those caused by a wrong offset, length
# or flag.
DAMAGED_ZIP = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, RuntimeError, ValueError, LookupError,
)  # fmt: skip
_UNIT_BY_NAME = {unit.value.lower(): unit for unit in Unit} | {
    "\u00b5g": Unit.UG,
    "\u03bcg": Unit.UG,
    "mcg": Unit.UG,
}


# Lengths of the database's columns.
MAX_KEY = 100
MAX_NAME = 300
MAX_GROUP = 100
MAX_MEASURE = 200
MAX_COMPONENT_NUMBER = 16


class ImportFileError(InvalidInputError):
    """A file cannot be imported; the message has the file, the line and the reason."""

    code = "food_import_invalid"

    def __init__(self, file: str, line: int | None, why: str) -> None:
        place = file if line is None else f"{file}, line {line}"
        super().__init__(f"{place}: {why}", file=file, line=line)


class Place(NamedTuple):
    """A line of a file, named in errors about its fields."""

    file: str
    line: int

    def error(self, why: str) -> ImportFileError:
        """Return the error that this line cannot be imported."""
        return ImportFileError(self.file, self.line, why)

    def number(self, field: str, text: str) -> float:
        """Return a field's finite number >= 0. Raises ImportFileError."""
        if not _NUMBER.match(text):
            hint = "; write decimals with a point" if re.fullmatch(r"\s*-?\d+,\d+\s*", text) else ""
            raise self.error(f"{field} is {text!r}, no number{hint}")
        value = float(text)
        if not 0.0 <= value < math.inf:
            raise self.error(f"{field} is {text.strip()}, which cannot be")
        return value

    def text(self, field: str, text: str, limit: int) -> str:
        """Return a field's text in one line.

        Raises ImportFileError if it is empty or longer than `limit`.
        """
        collapsed = " ".join(text.split())
        if not collapsed:
            raise self.error(f"{field} is empty")
        if len(collapsed) > limit:
            raise self.error(f"{field} has {len(collapsed)} characters; at most {limit} are kept")
        return collapsed

    def new_key(self, row: str, key: str, seen: Container[str]) -> str:
        """Return the key of a row. Raises ImportFileError if it is empty or in `seen`."""
        if not key:
            raise self.error(f"{row} has no id")
        if key in seen:
            raise self.error(f"{row} {key} is there twice")
        return key


class SourceFiles:
    """The files at a path: a zip, a folder, or one plain file.

    Names are matched without folder, ignoring case.

    plain_file: the name of the one plain file, None for a zip or a folder.

    Raises ImportFileError if there is nothing at the path, or a zip there is damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.exists():
            raise ImportFileError(str(path), None, "there is no such file or folder")
        self._is_zip = path.is_file() and (
            path.suffix.lower() == ".zip" or zipfile.is_zipfile(path)
        )
        if path.is_dir():
            members = [str(file) for file in sorted(path.rglob("*")) if file.is_file()]
        else:
            members = _members_of_zip(path) if self._is_zip else [str(path)]
        self.plain_file = None if self._is_zip or path.is_dir() else path.name
        self._members: dict[str, list[str]] = {}
        for member in members:
            self._members.setdefault(_plain_name(member), []).append(member)

    def has(self, name: str) -> bool:
        """Return whether there is a file of this name."""
        return name.upper() in self._members

    def require(self, names: Iterable[str]) -> None:
        """Raise ImportFileError if one of these files is missing, or exists more than once (two releases)."""
        for name in names:
            if not self.has(name):
                raise ImportFileError(
                    str(self._path), None, f"it holds no {name}; give the release whole"
                )
            members = self._members[name.upper()]
            if len(members) > 1:
                raise ImportFileError(
                    str(self._path), None, f"it holds {name} more than once: {', '.join(members)}"
                )

    def checksum(self, names: Iterable[str]) -> str:
        """Return the SHA-256, hex, of these files' names and contents: the same for a zip and its unpacked folder."""
        digest = hashlib.sha256()
        for name in sorted(name.upper() for name in names if self.has(name)):
            digest.update(f"{name}\n".encode())
            with self.open(name) as file:
                while chunk := file.read(_CHUNK):
                    digest.update(hashlib.sha256(chunk).digest())
        return digest.hexdigest()

    def lines(self, name: str, encoding: str) -> Iterator[tuple[int, str]]:
        """Yield each line with its number, from 1, without its end.

        Raises ImportFileError for another encoding.
        """
        with self.open(name) as file:
            for number, raw in enumerate(file, start=1):
                yield number, _decode(raw, encoding, name, number)

    def csv_header(self, name: str, columns: Iterable[str] = ()) -> list[str]:
        """Return the columns of a UTF-8 CSV file.

        Raises ImportFileError if a column of `columns` is missing, or a column is there twice.
        """
        with closing(self._csv_records(name)) as records:
            _, header = next(records, (1, []))
        header = [column.strip() for column in header]
        missing = [column for column in columns if column not in header]
        if missing:
            raise ImportFileError(
                name, 1, f"no column {', '.join(missing)}; there are {', '.join(header)}"
            )
        twice = sorted({column for column in header if header.count(column) > 1})
        if twice:
            raise ImportFileError(name, 1, f"column {', '.join(twice)} is there twice")
        return header

    def csv_rows(
        self, name: str, columns: Iterable[str] = ()
    ) -> Iterator[tuple[Place, dict[str, str]]]:
        """Yield each row of a UTF-8 CSV file, its trimmed fields by column.

        Raises errors as csv_fields does.
        """
        header = self.csv_header(name, columns)
        for place, fields in self.csv_fields(name, header):
            yield place, dict(zip(header, fields, strict=True))

    def csv_fields(
        self, name: str, columns: Iterable[str], of: Container[str] | None = None
    ) -> Iterator[tuple[Place, tuple[str, ...]]]:
        """Yield each row's trimmed fields of these columns, with the line that the row ends in.

        of: yield only the rows whose first of these fields is in it. Raises ImportFileError as
        csv_header does, and if a row is longer or shorter than the header, or a quote is never
        closed.
        """
        columns = tuple(columns)
        header = self.csv_header(name, columns)
        indices = [header.index(column) for column in columns]
        first, width = indices[0] if indices else 0, len(header)
        records = self._csv_records(name)
        next(records, None)
        for line, row in records:
            if len(row) != width:
                if not row:
                    continue
                raise ImportFileError(name, line, f"{len(row)} fields under {width} columns")
            if of is None or row[first].strip() in of:
                yield Place(name, line), tuple([row[index].strip() for index in indices])

    def _csv_records(self, name: str) -> Generator[tuple[int, list[str]]]:
        reader = csv.reader(self._csv_lines(name), strict=True)
        try:
            for row in reader:
                yield reader.line_num, row
        except csv.Error as error:
            raise ImportFileError(name, reader.line_num, f"no proper CSV: {error}") from None

    def _csv_lines(self, name: str) -> Iterator[str]:
        with self.open(name) as file:
            for number, raw in enumerate(file, start=1):
                # the fast path for nearly all of twenty million lines
                if raw.isascii() and b"\0" not in raw:
                    yield raw.decode("ascii")
                else:
                    yield _decode(raw, "utf-8-sig", name, number) + "\n"

    @contextmanager
    def open(self, name: str) -> Iterator[IO[bytes]]:
        """Open one file to read bytes.

        Raises ImportFileError if it is missing, or the zip is damaged there.
        """
        self.require([name])
        (member,) = self._members[name.upper()]
        try:
            if self._is_zip:
                with zipfile.ZipFile(self._path) as archive, archive.open(member) as file:
                    yield file
            else:
                with Path(member).open("rb") as file:
                    yield file
        except DAMAGED_ZIP as error:
            raise ImportFileError(
                str(self._path), None, f"{member} in it cannot be unpacked: {error}"
            ) from None
        except OSError as error:
            raise ImportFileError(member, None, f"it cannot be read: {error.strerror}") from None


def _members_of_zip(path: Path) -> list[str]:
    try:
        with zipfile.ZipFile(path) as archive:
            return [entry.filename for entry in archive.infolist() if not entry.is_dir()]
    except (*DAMAGED_ZIP, OSError):
        why = "it is no zip file, or only a part of one; download the release again"
        raise ImportFileError(str(path), None, why) from None


def _plain_name(member: str) -> str:
    return re.split(r"[/\\]", member)[-1].upper()


def _decode(raw: bytes, encoding: str, name: str, number: int) -> str:
    try:
        text = raw.decode(
            "utf-8-sig"
            if encoding == "utf-8-sig" and number == 1
            else encoding.removesuffix("-sig")
        )
    except UnicodeDecodeError as error:
        why = f"byte {error.object[error.start]:#04x} is not {encoding.removesuffix('-sig')}: another encoding"
        raise ImportFileError(name, number, why) from None
    if "\0" in text:
        raise ImportFileError(
            name, number, "it holds NUL bytes: another encoding (UTF-16?), or no text"
        )
    if encoding == "cp1252" and not raw.isascii() and _is_utf8(raw):
        raise ImportFileError(
            name, number, "it is UTF-8, the release is Windows-1252: give it as published"
        )
    return text.rstrip("\r\n")


def _is_utf8(raw: bytes) -> bool:
    try:
        raw.decode()
    except UnicodeDecodeError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class ImportedTable:
    """A release to be written.

    source: the importer's format. components: all components of its foods.

    skipped: the things left out.
    """

    source: str
    table: FoodTable
    components: tuple[Component, ...]
    skipped: "Skipped"


@dataclass(slots=True)
class Skipped:
    """Things left out: their number per reason, and the first few by name."""

    counts: Counter[str] = field(default_factory=Counter)
    examples: dict[str, list[str]] = field(default_factory=dict)

    def add(self, reason: str, thing: str) -> None:
        """Count a thing that is left out."""
        self.counts[reason] += 1
        examples = self.examples.setdefault(reason, [])
        if len(examples) < 5:
            examples.append(thing)

    def sentences(self) -> Iterator[str]:
        """Yield a line per reason: `12 portions without a weight (01001 cup, ...)`."""
        for reason, count in self.counts.most_common():
            shown = ", ".join(self.examples[reason])
            yield f"{count} {reason} ({shown}{', ...' if count > len(self.examples[reason]) else ''})"


@dataclass(frozen=True, slots=True)
class SourceComponent:
    """A component in a source; factor: converts its figures to the component's unit."""

    component: Component
    factor: float


def unit_of(name: str) -> Unit | None:
    """Return a unit by its name in a table (KCAL, µg, mcg ...), or None."""
    return _UNIT_BY_NAME.get(name.strip().lower())


def source_component(place: Place, number: str, name: str, unit_name: str) -> SourceComponent:
    """Return a source's component by its number, with the conversion to the component's unit.

    An unknown number becomes a new component without a tagname. Raises ImportFileError if the unit
    is unknown, or measures another quantity than the component's.
    """
    if len(number) > MAX_COMPONENT_NUMBER:
        raise place.error(f"component number {number!r} is too long to be one")
    unit = unit_of(unit_name)
    if unit is None:
        raise place.error(f"component {number} ({name}): unknown unit {unit_name!r}")
    component = COMPONENT_BY_NUMBER.get(number)
    if component is None:
        return SourceComponent(Component(number, name, unit, None, None), 1.0)
    try:
        return SourceComponent(component, convert(1.0, unit, component.unit))
    except UnitMismatchError:
        raise place.error(
            f"component {number} ({name}) is given in {unit_name}, which does not fit {component.unit}"
        ) from None


def sorted_components(components: Mapping[str, Component]) -> tuple[Component, ...]:
    """Return components in the order of components.csv, then unlisted ones."""
    listed = [
        component for number, component in COMPONENT_BY_NUMBER.items() if number in components
    ]
    return (
        *listed,
        *(
            component
            for number, component in components.items()
            if number not in COMPONENT_BY_NUMBER
        ),
    )
