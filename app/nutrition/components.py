"""The components of food tables: number, INFOODS tagname, unit and expression (components.csv).

The key is the source's number: USDA's nutrient number, shared by SR and FoodData Central, or the
INFOODS tagname of a component without a USDA number. A tagname alone is not a key: USDA uses VITD
for both 324 (IU) and 328 (ug). A tagname implies a definition, so similar components are kept
apart: CHOCDF (carbohydrate by difference, fibre included) is not CHOAVL (available), FOL (total
folate, by mass) is not FOLDFE (dietary folate equivalents), VITA_RAE is not RETOL.
"""

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Final, TypeVar

from app.core.units import Unit

T = TypeVar("T")


@cache  # a basal rate is looked up for each participant
def packaged_rows(*path: str) -> Sequence[Mapping[str, str]]:
    """Return the rows of a CSV file by column. path: below app/nutrition."""
    text = resources.files("app.nutrition").joinpath(*path).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


@dataclass(frozen=True, slots=True)
class Component:
    """One component: figures are in `unit` per 100 g edible portion.

    tagname: None if INFOODS has none. expression: the definition of the figure, if the name is
    ambiguous.
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

# FoodData Central's Foundation foods have energy by specific or general Atwater factors in place of
# 208: all are kilocalories of metabolisable energy.
ENERGY_NUMBERS = ("208", "958", "957")


@dataclass(frozen=True, slots=True)
class Headline:
    """A component that an effective record has as a column.

    column: named after the component and its unit
    label: the component's name on pages
    meaning: the component's name in the data dictionary
    numbers: of the components that hold it, the best first
    is_compared: whether a person's feedback compares it with a reference intake, as it is
    """

    column: str
    label: str
    meaning: str
    numbers: tuple[str, ...]
    is_compared: bool = False

    @property
    def unit(self) -> str:
        """The unit of the column."""
        return self.column.rpartition("_")[2]

    def best_of(self, by_number: Mapping[str, T]) -> T | None:
        """Return the value of the best of its numbers that has one."""
        return next((by_number[number] for number in self.numbers if number in by_number), None)


def _headline(
    column: str, label: str, meaning: str, tagname: str, *, is_compared: bool = False
) -> Headline:
    return Headline(column, label, meaning, (NUMBER_BY_TAGNAME[tagname],), is_compared)


# In the order of a record's columns. Tables, answers, exports and pages follow from it; a new one
# needs a migration of effective_record, and a name_... in messages/feedback.toml if it is compared.
HEADLINES: tuple[Headline, ...] = (
    Headline("energy_kcal", "Energy", "Energy (metabolisable)", ENERGY_NUMBERS),
    _headline("protein_g", "Protein", "Protein", "PROCNT", is_compared=True),
    _headline("fat_g", "Fat", "Total fat", "FAT"),
    _headline(
        "carbohydrate_g",
        "Carbohydrate",
        "Carbohydrate by difference, fibre included (CHOCDF),",
        "CHOCDF",
    ),
    _headline("fibre_g", "Fibre", "Total dietary fibre", "FIBTG", is_compared=True),
    _headline("sugar_g", "Sugar", "Total sugars", "SUGAR"),
    _headline("saturated_fat_g", "Saturated fat", "Saturated fatty acids", "FASAT"),
    _headline("sodium_mg", "Sodium", "Sodium", "NA", is_compared=True),
    _headline("potassium_mg", "Potassium", "Potassium", "K", is_compared=True),
    _headline("vitamin_c_mg", "Vitamin C", "Vitamin C", "VITC", is_compared=True),
)
HEADLINE_COLUMNS = tuple(headline.column for headline in HEADLINES)
HEADLINE_BY_COLUMN = MappingProxyType({headline.column: headline for headline in HEADLINES})

# In reading order; the members of a group are in the order of their `place`.
OTHERS: Final = "Others"
COMPONENT_GROUPS: Final = (
    "Energy and macronutrients", "Minerals", "Vitamins", "Starch and single sugars", "Amino acids", "Sterols",
    "Stimulants",
)  # fmt: skip
FATTY_ACIDS: Final = "Fatty acids"
# named by carbons and double bonds: "18:3 n-3 c,c,c (ALA)"
_FATTY_ACID = re.compile(r"\d+:\d|Fatty acids")
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
    """Group the values of components, both in reading order.

    components: number, name and value of each.
    """
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
