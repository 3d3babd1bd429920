"""Rows of a part as texts, many at a time: what CSV and NDJSON have in common."""

from collections.abc import Callable
from typing import Any

MOST_KNOWN = 20_000  # texts that are kept encoded

Row = tuple[Any, ...]


class Encoded(dict[Row, str]):
    """The texts of a shared part's rows, each made once."""

    def __init__(self, encode: Callable[[Row], str]) -> None:
        super().__init__()
        self._encode = encode

    def __missing__(self, row: Row) -> str:
        """A row that is not known yet."""
        text = self[row] = self._encode(row)
        return text

    def of(self, rows: list[Row]) -> list[str]:
        """The text of each row."""
        if len(self) > MOST_KNOWN:
            self.clear()
        return list(map(self.__getitem__, rows))
