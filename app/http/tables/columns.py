"""What a table is made of: columns with their meaning, in parts that stand side by side; batches of rows.

Whoever writes a file, and the data dictionary, go by these definitions and nothing else.
"""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone
from itertools import chain, repeat
from typing import Any, Generic, Literal, Self, TypeVar, cast

ColumnType = Literal["id", "word", "instant", "local time", "day", "number", "integer", "boolean", "words"]
PartType = Literal["id", "shared", "numbers"]
Cell = str | float | bool | None | tuple[str, ...]
Row = Sequence[Cell]
Cells = Sequence[Cell | Row]  # of a part: a row's values, or of a single column the value itself

MOST_CONVERTED = 20_000  # values kept by ConvertedOnce: most participants and foods

Value = TypeVar("Value", bound=Hashable)
Item = TypeVar("Item")
Converted = TypeVar("Converted")


@dataclass(frozen=True, slots=True)
class Column:
    """A column. type: a "word" is any text, of which there are few. unit: None where the values have none.

    meaning: one or a few sentences for the data dictionary. values: all that there can be, where that is a short list.
    empty: what an empty cell says; None: there is none.
    """

    name: str
    type: ColumnType
    unit: str | None = None
    meaning: str = ""
    values: tuple[str, ...] = ()
    empty: str | None = None


@dataclass(frozen=True, slots=True)
class Part:
    """Columns side by side that come from one place.

    Of a "shared" part many rows have the same values (those of one meal, one food ...), so that whoever writes them
    does it once for all of these rows; of "numbers" every row has its own, and nothing else; an "id" is a row's own
    text, never empty.
    """

    type: PartType
    columns: tuple[Column, ...]


@dataclass(frozen=True, slots=True)
class PartOfBatch:
    """Some rows of a part: a tuple of values a row, in the order of the columns; of a single column the value itself.

    places: where `rows` has each row of the batch, if many of them are the same; None: `rows` are those of the batch.
    Values are text, float, int, bool, None, and a tuple of texts for "words"; instants and days are RFC 3339 text, as
    JSON has them, local times the same without offset. What a shared part has can be hashed.
    """

    part: Part
    rows: Cells
    places: Sequence[int] | None = None

    def __len__(self) -> int:
        """Return the number of the batch's rows."""
        return len(self.rows if self.places is None else self.places)

    def deduplicated(self) -> Self:
        """Return a shared part with each different row once; any other part as it is."""
        if self.part.type != "shared" or self.places is not None:
            return self
        rows, places = distinct(self.rows)
        return replace(self, rows=rows, places=places)

    def converted(self, convert: Callable[[Any], Cell | Row]) -> Self:
        """Return it with each of `rows` converted."""
        return replace(self, rows=list(map(convert, self.rows)))

    def columns(self) -> Sequence[Sequence[Cell]]:
        """Return the columns of `rows`, from left to right."""
        return list(zip(*self.rows, strict=True)) if len(self.part.columns) > 1 else [cast("Sequence[Cell]", self.rows)]

    def spread(self, values: Sequence[Item]) -> Sequence[Item]:
        """Return one of the values, which are those of `rows`, for each of the batch's rows."""
        return values if self.places is None else list(map(values.__getitem__, self.places))

    def as_tuples(self) -> Iterable[Row]:
        """Return the batch's rows as tuples, whatever the number of columns."""
        rows = self.spread(self.rows)
        return cast("Iterable[Row]", rows if len(self.part.columns) > 1 else zip(rows, strict=True))

    def piece(self, start: int, end: int) -> Self:
        """Return the batch's rows from `start` to `end`."""
        if self.places is None:
            return replace(self, rows=self.rows[start:end])
        return replace(self, places=self.places[start:end])

    def repeated(self, count: int) -> Self:
        """Return each of the batch's rows `count` times in a row."""
        places = range(len(self.rows)) if self.places is None else self.places
        return replace(self, places=list(chain.from_iterable(repeat(place, count) for place in places)))


Batch = list[PartOfBatch]


class ConvertedOnce(dict[Value, Converted], Generic[Value, Converted]):
    """Converts values and keeps the results, since the same values come again and again."""

    def __init__(self, convert: Callable[[Value], Converted]) -> None:
        super().__init__()
        self._convert = convert

    def __missing__(self, value: Value) -> Converted:
        """Convert a new value."""
        converted = self[value] = self._convert(value)
        return converted

    def of(self, values: Iterable[Value]) -> list[Converted]:
        """Return each value converted."""
        if len(self) > MOST_CONVERTED:
            self.clear()
        return list(map(self.__getitem__, values))


def distinct(values: Iterable[Value]) -> tuple[list[Value], list[int]]:
    """Return the different values in their first order, and the place of each value among them."""
    values = list(values)
    numbers = {value: number for number, value in enumerate(dict.fromkeys(values))}
    return list(numbers), list(map(numbers.__getitem__, values))


def columns_of(parts: Iterable[Part]) -> tuple[Column, ...]:
    """All columns, from left to right."""
    return tuple(column for part in parts for column in part.columns)


def rows_of(part: Part, rows: Sequence[Row]) -> Cells:
    """Rows of values as a PartOfBatch has them: of a single column the value itself."""
    return rows if len(part.columns) > 1 else [value for (value,) in rows]


def as_row(columns: Sequence[Column], values: Cell | Row) -> Row:
    """Return a part's row, of a single column too."""
    return cast("Row", values if len(columns) > 1 else (values,))


def instant_text(instant: datetime) -> str:
    """As JSON has it: UTC, microseconds where there are any."""
    return f"{instant.astimezone(UTC).isoformat().removesuffix('+00:00')}Z"


def local_text(instant: datetime, offset_minutes: int) -> str:
    """What a wall clock so far ahead of UTC shows at an aware instant: ISO 8601 without offset."""
    return instant.astimezone(timezone(timedelta(minutes=offset_minutes))).replace(tzinfo=None).isoformat()
