"""What CSV and NDJSON have in common: texts that are made once and kept, since the same values come again and again."""

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

MOST_KNOWN = 4000  # that are kept: a few batches' meals, most foods; more would cost the garbage collector's time

Value = TypeVar("Value")
Made = TypeVar("Made")


class MadeOnce(dict[Value, Made], Generic[Value, Made]):
    """What is made of values, each once."""

    def __init__(self, make: Callable[[Value], Made]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, value: Value) -> Made:
        """Of a value that is not known yet."""
        made = self[value] = self._make(value)
        return made

    def of(self, values: Iterable[Value]) -> list[Made]:
        """Of each of these."""
        if len(self) > MOST_KNOWN:
            self.clear()
        return list(map(self.__getitem__, values))
