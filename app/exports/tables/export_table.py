"""A table to be written: its columns, and its rows in batches that are read as they are asked for."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from app.http.tables.columns import Batch, Cell, Part, PartOfBatch, Row, as_row

Source = TypeVar("Source")
Readers = Mapping[Part, Callable[[Source], Cell | Row]]  # how the values of a part are read from what a row is made of


@dataclass(frozen=True, slots=True)
class Table:
    """parts: the columns. batches: of these parts, for GeoJSON with the POINT behind them; to be read once."""

    parts: tuple[Part, ...]
    batches: Iterator[Batch]


def batch_of(parts: Sequence[Part], readers: Readers[Source], sources: Sequence[Source]) -> Batch:
    """Return the rows of these parts."""
    return [PartOfBatch(part, list(map(readers[part], sources))) for part in parts]


def named_cells(parts: Sequence[Part], readers: Readers[Source], source: Source) -> dict[str, Cell]:
    """Return a row's values by the names of the columns."""
    return {
        column.name: cell
        for part in parts
        for column, cell in zip(part.columns, as_row(part.columns, readers[part](source)), strict=True)
    }
