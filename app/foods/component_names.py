"""Components as a person names them, by their source's number or INFOODS tagname -> numbers, figures in their unit."""

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


def numbers_called(session: Session, named: Mapping[str, T]) -> dict[str, T]:
    """Number or tagname -> value, as number -> value.

    Raises InvalidInputError: `component_unknown`, naming it; `component_repeated` where two names mean the same.
    """
    known = foods.components_by_number(session)
    found: dict[str, T] = {}
    for name, value in named.items():
        number = _number_called(name, known)
        if number in found:
            raise InvalidInputError(
                f"Component {name!r} is there twice, by number and by tagname.",
                code="component_repeated",
                component=name,
            )
        found[number] = value
    return found


def contents_of(session: Session, figures: Mapping[str, Figure]) -> dict[str, float]:
    """Number -> figure, as number -> content in the component's own unit.

    Raises InvalidInputError `unit_differs` where the figure's unit measures another quantity.
    """
    known = foods.components_by_number(session)
    contents: dict[str, float] = {}
    for number, figure in figures.items():
        component = COMPONENT_BY_NUMBER.get(number) or known[number]
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
    """Rows for the components of components.csv that no table has brought yet."""
    known = foods.components_by_number(session)
    session.add_all(
        component_row(component)
        for number, component in COMPONENT_BY_NUMBER.items()
        if number in numbers and number not in known
    )
    session.flush()


def component_row(component: ComponentValue) -> Component:
    """Return a row for a component."""
    row = asdict(component)
    return Component(**row | {"name": component.name[:200], "unit": component.unit.value})


def _number_called(name: str, known: Mapping[str, Component]) -> str:
    if name in known or name in COMPONENT_BY_NUMBER:
        return name
    number = NUMBER_BY_TAGNAME.get(name.upper())
    if number is None:
        raise InvalidInputError(
            f"There is no component {name!r}: give its number or its INFOODS tagname, as GET /v1/foods/KEY shows them.",
            code="component_unknown",
            component=name,
        )
    return number
