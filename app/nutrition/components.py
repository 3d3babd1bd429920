"""The components of food tables: number, INFOODS tagname, unit and expression (components.csv).

The key is the source's number: USDA's nutrient number, shared by SR and FoodData Central, or the INFOODS tagname of a
component without a USDA number. A tagname alone is not a key: USDA uses VITD for both 324 (IU) and 328 (ug). A tagname
implies a definition, so similar components are kept apart: CHOCDF (carbohydrate by difference, fibre included) is not
CHOAVL (available), FOL (total folate, by mass) is not FOLDFE (dietary folate equivalents), VITA_RAE is not RETOL.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, TypeVar

from app.core.units import Unit
from app.nutrition.packaged_rows import packaged_rows

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Component:
    """One component: figures are in `unit` per 100 g edible portion.

    tagname: None if INFOODS has none. expression: the definition of the figure, if the name is ambiguous.
    """

    number: str
    name: str
    unit: Unit
    tagname: str | None
    expression: str | None


_ROWS = packaged_rows("components.csv")
COMPONENTS: tuple[Component, ...] = tuple(
    Component(
        row["number"],
        row["name"],
        Unit(row["unit"]),
        row["tagname"] or None,
        row["expression"] or None,
    )
    for row in _ROWS
)
COMPONENT_BY_NUMBER = MappingProxyType({component.number: component for component in COMPONENTS})

# Where two numbers share a tagname (VITD), the file names the one in ug first.
NUMBER_BY_TAGNAME = MappingProxyType(
    {component.tagname: component.number for component in reversed(COMPONENTS) if component.tagname}
)

# The ten components that an effective record has as columns (design.md, "HTTP conventions"). FoodData Central's
# Foundation foods have energy by specific or general Atwater factors in place of 208: all are kilocalories of
# metabolisable energy.
ENERGY_NUMBERS = ("208", "958", "957")
HEADLINE_NUMBERS: tuple[tuple[str, ...], ...] = (
    ENERGY_NUMBERS,
    *((NUMBER_BY_TAGNAME[tagname],) for tagname in (
        "PROCNT", "FAT", "CHOCDF", "FIBTG", "SUGAR", "FASAT", "NA", "K", "VITC",
    )),
)  # fmt: skip

# In reading order; the members of a group are in the order of their `place`.
OTHERS: Final = "Others"
COMPONENT_GROUPS: Final = (
    "Energy and macronutrients", "Minerals", "Vitamins", "Starch and single sugars", "Amino acids", "Sterols",
    "Stimulants",
)  # fmt: skip
FATTY_ACIDS: Final = "Fatty acids"
_FATTY_ACID = re.compile(
    r"\d+:\d|Fatty acids"
)  # named by carbons and double bonds: "18:3 n-3 c,c,c (ALA)"
_PLACE = {row["number"]: (row["group"], int(row["place"])) for row in _ROWS if row["group"]}


def is_fatty_acid(name: str) -> bool:
    """Return whether a component is a fatty acid or a sum of them, by its name."""
    return _FATTY_ACID.match(name) is not None


def component_group(number: str, name: str) -> str:
    """Return the group of a component."""
    if number in _PLACE:
        return _PLACE[number][0]
    return FATTY_ACIDS if is_fatty_acid(name) else OTHERS


def by_component_group(components: Iterable[tuple[str, str, T]]) -> dict[str, list[T]]:
    """Group the values of components, both in reading order. components: number, name and value of each."""
    groups: dict[str, list[tuple[int, T]]] = {
        group: [] for group in (*COMPONENT_GROUPS, FATTY_ACIDS, OTHERS)
    }
    for number, name, value in components:
        groups[component_group(number, name)].append((_PLACE.get(number, ("", 0))[1], value))
    return {
        group: [value for _, value in sorted(members, key=lambda member: member[0])]
        for group, members in groups.items()
        if members
    }
