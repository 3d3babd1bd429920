"""The components that food tables give figures of: number, INFOODS tagname, unit and expression (components.csv).

The key is the source's number: USDA's nutrient number, shared by SR and FoodData Central, or, for a component that USDA
has no number for, its INFOODS tagname. A tagname alone is no key: USDA calls both 324 (IU) and 328 (ug) VITD. It says
how a figure was arrived at, so neighbours stay apart: CHOCDF (carbohydrate by difference, fibre included) is not CHOAVL
(available), FOL (total folate, by mass) is not FOLDFE (dietary folate equivalents), VITA_RAE is not RETOL.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, TypeVar

from app.nutrition.packaged_rows import packaged_rows
from app.units import Unit

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Component:
    """One component: figures are in `unit` per 100 g edible portion.

    tagname: None where INFOODS has none. expression: what kind of figure it is, where the name leaves a choice.
    """

    number: str
    name: str
    unit: Unit
    tagname: str | None
    expression: str | None


COMPONENTS: tuple[Component, ...] = tuple(
    Component(row["number"], row["name"], Unit(row["unit"]), row["tagname"] or None, row["expression"] or None)
    for row in packaged_rows("components.csv")
)
COMPONENT_BY_NUMBER = MappingProxyType({component.number: component for component in COMPONENTS})

# Where two numbers share a tagname (VITD), the file names the one in ug first.
NUMBER_BY_TAGNAME = MappingProxyType(
    {component.tagname: component.number for component in reversed(COMPONENTS) if component.tagname}
)

# The ten that an effective record carries as columns (design.md, "HTTP conventions"). FoodData Central's Foundation
# foods give energy by the Atwater factors, specific or general, in place of 208: all are kilocalories of metabolisable
# energy.
ENERGY_NUMBERS = ("208", "958", "957")
HEADLINE_NUMBERS: tuple[tuple[str, ...], ...] = (
    ENERGY_NUMBERS,
    *((NUMBER_BY_TAGNAME[tagname],) for tagname in (
        "PROCNT", "FAT", "CHOCDF", "FIBTG", "SUGAR", "FASAT", "NA", "K", "VITC",
    )),
)  # fmt: skip

# As a reader looks for them.
OTHERS: Final = "Others"
COMPONENT_GROUPS: Final = MappingProxyType(
    {
        "Energy and macronutrients": (
            *("208", "958", "957", "268", "203", "257", "202", "204", "205", "205.2", "CHOAVL", "CHOAVLM", "CHOAVLDF"),
            *("269", "539", "291", "FIB-", "606", "645", "646", "605", "601", "221", "255", "207"),
        ),
        "Minerals": (
            *("307", "306", "301", "303", "304", "305", "309", "312", "315", "317", "314", "313", "310", "316", "302"),
        ),
        "Vitamins": (
            *("401", "404", "405", "406", "NIAEQ", "410", "415", "416", "417", "431", "432", "435", "FOLSUM", "418"),
            *("578", "320", "VITA", "318", "319", "321", "CARTBEQ", "322", "334", "337", "338", "328", "324", "325"),
            *("326", "323", "VITE", "573", "341", "342", "343", "344", "345", "346", "347", "430", "428", "429"),
            *("421", "454"),
        ),
        "Starch and single sugars": ("209", "210", "211", "212", "287", "213", "214"),
        "Amino acids": (
            *("501", "502", "503", "504", "505", "506", "507", "508", "509", "510", "511", "512", "513", "514", "515"),
            *("516", "517", "518", "521"),
        ),
        "Sterols": ("636", "638", "639", "641"),
        "Stimulants": ("262", "263"),
    }
)
FATTY_ACIDS: Final = "Fatty acids"
_FATTY_ACID = re.compile(r"\d+:\d|Fatty acids")  # named by carbons and double bonds: "18:3 n-3 c,c,c (ALA)"
_PLACE = {number: (group, place) for group, numbers in COMPONENT_GROUPS.items() for place, number in enumerate(numbers)}


def is_fatty_acid(name: str) -> bool:
    """Return whether a component is a fatty acid or a sum of them, by its name."""
    return _FATTY_ACID.match(name) is not None


def component_group(number: str, name: str) -> str:
    """Return the group of a component."""
    if number in _PLACE:
        return _PLACE[number][0]
    return FATTY_ACIDS if is_fatty_acid(name) else OTHERS


def by_component_group(components: Iterable[tuple[str, str, T]]) -> dict[str, list[T]]:
    """Sort values of components into groups, both in a reader's order. components: number, name and value of each."""
    groups: dict[str, list[tuple[int, T]]] = {group: [] for group in (*COMPONENT_GROUPS, FATTY_ACIDS, OTHERS)}
    for number, name, value in components:
        groups[component_group(number, name)].append((_PLACE.get(number, ("", 0))[1], value))
    return {
        group: [value for _, value in sorted(members, key=lambda member: member[0])]
        for group, members in groups.items()
        if members
    }
