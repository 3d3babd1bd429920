"""What every importer gives: a whole table, checked, with what was left out of it and why."""

import math
import re
from collections import Counter
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field

from app.nutrition.components import COMPONENT_BY_NUMBER, Component
from app.nutrition.foods import FoodTable
from app.nutrition.importers.source_files import ImportFileError
from app.units import Unit, UnitMismatchError, convert

# float() also takes 1_000, inf, nan and the digits of other scripts.
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*\Z", re.ASCII)

_UNIT_BY_NAME = {unit.value.lower(): unit for unit in Unit} | {"\u00b5g": Unit.UG, "\u03bcg": Unit.UG, "mcg": Unit.UG}


# What the database has room for.
MAX_KEY = 100
MAX_NAME = 300
MAX_GROUP = 100
MAX_MEASURE = 200
MAX_COMPONENT_NUMBER = 16


@dataclass(frozen=True, slots=True)
class ImportedTable:
    """A release, ready to be written. source: the importer's format. components: all that its foods have figures of.

    skipped: reason -> the things left out for it.
    """

    source: str
    table: FoodTable
    components: tuple[Component, ...]
    skipped: "Skipped"


@dataclass(slots=True)
class Skipped:
    """What was left out: how many a reason, and the first few of them by name."""

    counts: Counter[str] = field(default_factory=Counter)
    examples: dict[str, list[str]] = field(default_factory=dict)

    def add(self, reason: str, thing: str) -> None:
        """Count one thing that was left out."""
        self.counts[reason] += 1
        examples = self.examples.setdefault(reason, [])
        if len(examples) < 5:
            examples.append(thing)

    def sentences(self) -> Iterator[str]:
        """One a reason: `12 portions without a weight (01001 cup, ...)`."""
        for reason, count in self.counts.most_common():
            shown = ", ".join(self.examples[reason])
            yield f"{count} {reason} ({shown}{', ...' if count > len(self.examples[reason]) else ''})"


@dataclass(frozen=True, slots=True)
class SourceComponent:
    """A component as a source gives it; factor: turns its figures into the component's unit."""

    component: Component
    factor: float


def unit_of(name: str) -> Unit | None:
    """A unit by the name that a table gives it (KCAL, µg, mcg ...), or None."""
    return _UNIT_BY_NAME.get(name.strip().lower())


def source_component(file: str, line: int, number: str, name: str, unit_name: str) -> SourceComponent:
    """A source's component by its number, its unit made to fit the one that is used here.

    A number that is not known here yet becomes a component without a tagname. Raises ImportFileError if the unit is
    unknown, or measures another quantity than the component's.
    """
    if len(number) > MAX_COMPONENT_NUMBER:
        raise ImportFileError(file, line, f"component number {number!r} is too long to be one")
    unit = unit_of(unit_name)
    if unit is None:
        raise ImportFileError(file, line, f"component {number} ({name}): unknown unit {unit_name!r}")
    known = COMPONENT_BY_NUMBER.get(number)
    if known is None:
        return SourceComponent(Component(number, name, unit, None, None), 1.0)
    try:
        return SourceComponent(known, convert(1.0, unit, known.unit))
    except UnitMismatchError:
        why = f"component {number} ({name}) is given in {unit_name}, which does not fit {known.unit}"
        raise ImportFileError(file, line, why) from None


def number_in(file: str, line: int, what: str, text: str) -> float:
    """A finite figure >= 0 from a field. Raises ImportFileError."""
    if not _NUMBER.match(text):
        hint = "; write decimals with a point" if re.fullmatch(r"\s*-?\d+,\d+\s*", text) else ""
        raise ImportFileError(file, line, f"{what} is {text!r}, no number{hint}")
    value = float(text)
    if not 0.0 <= value < math.inf:
        raise ImportFileError(file, line, f"{what} is {text.strip()}, which cannot be")
    return value


def text_in(file: str, line: int, what: str, text: str, limit: int) -> str:
    """A text of at most `limit` characters, in one line. Raises ImportFileError if it is empty or longer."""
    words = " ".join(text.split())
    if not words:
        raise ImportFileError(file, line, f"{what} is empty")
    if len(words) > limit:
        raise ImportFileError(file, line, f"{what} has {len(words)} characters; at most {limit} are kept")
    return words


def key_once(file: str, line: int, what: str, key: str, seen: Container[str]) -> str:
    """A row's key, as it is. Raises ImportFileError if it is empty or was seen before."""
    if not key:
        raise ImportFileError(file, line, f"{what} has no id")
    if key in seen:
        raise ImportFileError(file, line, f"{what} {key} is there twice")
    return key


def sorted_components(components: Mapping[str, Component]) -> tuple[Component, ...]:
    """Components in the order of components.csv, unknown ones behind."""
    known = [component for number, component in COMPONENT_BY_NUMBER.items() if number in components]
    return (*known, *(component for number, component in components.items() if number not in COMPONENT_BY_NUMBER))
