"""Form fields with structure: numbers, and text areas of one entry per line with parts separated by semicolons."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

T = TypeVar("T")

_NUMBER = re.compile(r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")
_DECIMAL_COMMA = re.compile(r"-?(?:0?,\d+|\d+,(?!\d{3}$)\d+)")


class WrongFieldError(ValueError):
    """The text of a field cannot be read; the message says why."""


def with_point(text: str) -> str:
    """Return a number that has a decimal comma with a point; `1,500` stays as it is, for it may be 1500."""
    return text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text


def number(text: str) -> float:
    """Read a number such as `4.6` or `4,6`. Raises WrongFieldError."""
    text = with_point(text)
    if not _NUMBER.fullmatch(text):
        raise WrongFieldError(f"“{text[:40]}” is no number: write it as 4.6.")
    return float(text)


def read_fields(
    texts: Mapping[str, str], readers: Mapping[str, Callable[[str], T]]
) -> tuple[dict[str, T], dict[str, str]]:
    """Return (field -> value, field -> why it cannot be read) for the texts that have a reader."""
    values: dict[str, T] = {}
    wrong: dict[str, str] = {}
    for name, text in texts.items():
        if name in readers:
            try:
                values[name] = readers[name](text)
            except WrongFieldError as error:
                wrong[name] = str(error)
    return values, wrong


def entries(text: str, names: Sequence[str], *, needed: int | None = None) -> list[dict[str, str]]:
    """Return each line of a text area as name -> part; `needed` parts are required, later ones may be missing.

    Raises WrongFieldError, which names the line.
    """
    rows = []
    for place, line in enumerate(lines(text), start=1):
        parts = [part.strip() for part in line.split(";", len(names) - 1)]
        if len(parts) < (needed or len(names)):
            raise WrongFieldError(
                f"Line {place} needs: {'; '.join(names[: needed or len(names)])}."
            )
        rows.append(dict(zip(names, parts, strict=False)))
    return rows


def lines(text: str) -> list[str]:
    """Return the lines that are not blank."""
    return [line.strip() for line in text.splitlines() if line.strip()]


def text_of(rows: Iterable[Sequence[object]]) -> str:
    """Format rows for a text area, so that `entries` reads them back."""
    return "\n".join("; ".join(shown(part) for part in row) for row in rows)


def shown(value: object) -> str:
    """Format a part so that it reads back as the same value."""
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)
