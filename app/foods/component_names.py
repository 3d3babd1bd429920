"""Resolve component names (source number or INFOODS tagname) to numbers; convert figures to the component's unit."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TypeVar

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.core.units import Unit, UnitMismatchError, convert
from app.foods import queries as foods
from app.foods.models import Component
from app.nutrition.components import COMPONENT_BY_NUMBER, NUMBER_BY_TAGNAME
from app.nutrition.components import Component as ComponentValue

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Figure:
    """Content of 100 g edible portion in this unit."""

    per_100_g: float
    unit: Unit


def component_numbers(session: Session, values: Mapping[str, T]) -> dict[str, T]:
    """Return the mapping with its keys, numbers or tagnames, replaced by numbers.

    Raises InvalidInputError: `component_unknown`, naming it; `component_repeated` where two names
    mean the same.
    """
    components = foods.components_by_number(session)
    by_number: dict[str, T] = {}
    for name, value in values.items():
        number = _component_number(name, components)
        if number in by_number:
            raise InvalidInputError(
                f"Component {name!r} is there twice, by number and by tagname.",
                code="component_repeated",
                component=name,
            )
        by_number[number] = value
    return by_number


def contents_of(session: Session, figures: Mapping[str, Figure]) -> dict[str, float]:
    """Return number -> content in the component's own unit.

    Raises InvalidInputError `unit_differs` if the figure's unit measures another quantity.
    """
    components = foods.components_by_number(session)
    contents: dict[str, float] = {}
    for number, figure in figures.items():
        component = COMPONENT_BY_NUMBER.get(number) or components[number]
        try:
            contents[number] = convert(figure.per_100_g, figure.unit, Unit(component.unit))
        except UnitMismatchError:
            raise InvalidInputError(
                f"{component.name} ({number}) is kept in {component.unit}, which {figure.unit} does not convert to.",
                code="unit_differs",
                component=number,
            ) from None
    return contents


def add_missing_components(session: Session, numbers: Mapping[str, object]) -> None:
    """Insert the components of components.csv among `numbers` that no table has added yet."""
    existing = foods.components_by_number(session)
    session.add_all(
        component_row(component)
        for number, component in COMPONENT_BY_NUMBER.items()
        if number in numbers and number not in existing
    )
    session.flush()


def component_row(component: ComponentValue) -> Component:
    """Return a row for a component."""
    row = asdict(component)
    return Component(**row | {"name": component.name[:200], "unit": component.unit.value})


def _component_number(name: str, components: Mapping[str, Component]) -> str:
    if name in components or name in COMPONENT_BY_NUMBER:
        return name
    number = NUMBER_BY_TAGNAME.get(name.upper())
    if number is None:
        raise InvalidInputError(
            f"There is no component {name!r}: give its number or its INFOODS tagname, as GET /v1/foods/KEY shows them.",
            code="component_unknown",
            component=name,
        )
    return number
