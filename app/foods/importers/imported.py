"""What every importer returns: a whole checked table, with what was left out of it and why."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from app.core.units import Unit, UnitMismatchError, convert
from app.foods.importers.source_files import Place
from app.nutrition.components import COMPONENT_BY_NUMBER, Component
from app.nutrition.foods import FoodTable

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


def source_component(place: Place, number: str, name: str, unit_name: str) -> SourceComponent:
    """Return a source's component by its number, its unit converted to the one that is used here.

    A number that is not known here yet becomes a component without a tagname. Raises ImportFileError if the unit is
    unknown, or measures another quantity than the component's.
    """
    if len(number) > MAX_COMPONENT_NUMBER:
        raise place.error(f"component number {number!r} is too long to be one")
    unit = unit_of(unit_name)
    if unit is None:
        raise place.error(f"component {number} ({name}): unknown unit {unit_name!r}")
    known = COMPONENT_BY_NUMBER.get(number)
    if known is None:
        return SourceComponent(Component(number, name, unit, None, None), 1.0)
    try:
        return SourceComponent(known, convert(1.0, unit, known.unit))
    except UnitMismatchError:
        raise place.error(
            f"component {number} ({name}) is given in {unit_name}, which does not fit {known.unit}"
        ) from None


def sorted_components(components: Mapping[str, Component]) -> tuple[Component, ...]:
    """Components in the order of components.csv, unknown ones behind."""
    known = [component for number, component in COMPONENT_BY_NUMBER.items() if number in components]
    return (*known, *(component for number, component in components.items() if number not in COMPONENT_BY_NUMBER))
