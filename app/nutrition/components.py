"""The components that food tables give figures of: number, INFOODS tagname, unit and expression (components.csv).

The key is the source's number: USDA's nutrient number, shared by SR and FoodData Central, or, for a component that USDA
has no number for, its INFOODS tagname. A tagname alone is no key: USDA calls both 324 (IU) and 328 (ug) VITD. It says
how a figure was arrived at, so neighbours stay apart: CHOCDF (carbohydrate by difference, fibre included) is not CHOAVL
(available), FOL (total folate, by mass) is not FOLDFE (dietary folate equivalents), VITA_RAE is not RETOL.
"""

import csv
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType

from app.units import Unit


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


def _read() -> tuple[Component, ...]:
    text = (resources.files("app.nutrition") / "components.csv").read_text(encoding="utf-8")
    return tuple(
        Component(row["number"], row["name"], Unit(row["unit"]), row["tagname"] or None, row["expression"] or None)
        for row in csv.DictReader(text.splitlines())
    )


COMPONENTS: tuple[Component, ...] = _read()
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
