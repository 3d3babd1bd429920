"""Lists in a form: a text area of one entry a line, its parts parted by semicolons; and numbers as they are typed."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

T = TypeVar("T")

_NUMBER = re.compile(r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")


class WrongFieldError(ValueError):
    """What was typed into a field cannot be read; its text says why."""


def number(text: str) -> float:
    """A number as people write it in English, `4.6`. Raises WrongFieldError: a comma may mean two things."""
    if not _NUMBER.fullmatch(text):
        raise WrongFieldError(f"“{text[:40]}” is no number: write it as 4.6.")
    return float(text)


def read_fields(
    texts: Mapping[str, str], readers: Mapping[str, Callable[[str], T]]
) -> tuple[dict[str, T], dict[str, str]]:
    """Return (field -> its value, field -> why it cannot be read), of the texts that have a reader."""
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
    """The lines of a text area, each as name -> part; parts at the end may be missing, `needed` of them not.

    Raises WrongFieldError, naming the line.
    """
    found = []
    for place, line in enumerate(lines(text), start=1):
        parts = [part.strip() for part in line.split(";", len(names) - 1)]
        if len(parts) < (needed or len(names)):
            raise WrongFieldError(f"Line {place} needs: {'; '.join(names[: needed or len(names)])}.")
        found.append(dict(zip(names, parts, strict=False)))
    return found


def lines(text: str) -> list[str]:
    """The lines with anything on them."""
    return [line.strip() for line in text.splitlines() if line.strip()]


def text_of(rows: Iterable[Sequence[object]]) -> str:
    """Rows as a text area has them: what `entries` reads back."""
    return "\n".join("; ".join(shown(part) for part in row) for row in rows)


def shown(value: object) -> str:
    """A part as it is typed: a number so that it reads back as the same."""
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)
