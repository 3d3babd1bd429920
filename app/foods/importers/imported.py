"""The result of an importer: a complete, validated table, and the things left out of it with reasons."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from app.core.units import Unit, UnitMismatchError, convert
from app.foods.importers.source_files import Place
from app.nutrition.components import COMPONENT_BY_NUMBER, Component
from app.nutrition.foods import FoodTable

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


@dataclass(frozen=True, slots=True)
class ImportedTable:
    """A release to be written. source: the importer's format. components: all components of its foods.

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

    An unknown number becomes a new component without a tagname. Raises ImportFileError if the unit is unknown, or
    measures another quantity than the component's.
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
