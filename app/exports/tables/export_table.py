"""A table to be written: its columns, and its rows in batches that are read as they are asked for."""

from collections.abc import Iterator
from dataclasses import dataclass

from app.http.tables.columns import Batch, Part


@dataclass(frozen=True, slots=True)
class Table:
    """parts: the columns. batches: of these parts, for GeoJSON with the POINT behind them; to be read once."""

    parts: tuple[Part, ...]
    batches: Iterator[Batch]
