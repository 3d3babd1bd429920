"""The components that the food table knows: INFOODS tagname, name, unit, and the number that SR28 gives each.

A tagname says how a figure was arrived at, so neighbours stay apart: CHOCDF (carbohydrate by difference, fibre
included) is not CHOAVL (available), FOL (total folate, by mass) is not FOLDFE (dietary folate equivalents), VITA_RAE
is not RETOL. The source's number is the key, not its tagname: SR28 calls both 324 (IU) and 328 (ug) VITD.
Kilojoules (268) are left out: units.py makes them from ENERC_KCAL.
"""

from dataclasses import dataclass
from types import MappingProxyType

from app.units import Unit


@dataclass(frozen=True, slots=True)
class Component:
    """One component: figures are in `unit` per 100 g edible portion. sr28_number: Nutr_No in NUTR_DEF.txt."""

    tagname: str
    name: str
    unit: Unit
    sr28_number: str


COMPONENTS: tuple[Component, ...] = (
    Component("WATER", "Water", Unit.G, "255"),
    Component("ENERC_KCAL", "Energy", Unit.KCAL, "208"),
    Component("PROCNT", "Protein", Unit.G, "203"),
    Component("FAT", "Total lipid (fat)", Unit.G, "204"),
    Component("CHOCDF", "Carbohydrate, by difference", Unit.G, "205"),
    Component("FIBTG", "Fiber, total dietary", Unit.G, "291"),
    Component("SUGAR", "Sugars, total", Unit.G, "269"),
    Component("FASAT", "Fatty acids, total saturated", Unit.G, "606"),
    Component("FAMS", "Fatty acids, total monounsaturated", Unit.G, "645"),
    Component("FAPU", "Fatty acids, total polyunsaturated", Unit.G, "646"),
    Component("FATRN", "Fatty acids, total trans", Unit.G, "605"),
    Component("CHOLE", "Cholesterol", Unit.MG, "601"),
    Component("ALC", "Alcohol, ethyl", Unit.G, "221"),
    Component("CAFFN", "Caffeine", Unit.MG, "262"),
    Component("CA", "Calcium, Ca", Unit.MG, "301"),
    Component("FE", "Iron, Fe", Unit.MG, "303"),
    Component("MG", "Magnesium, Mg", Unit.MG, "304"),
    Component("P", "Phosphorus, P", Unit.MG, "305"),
    Component("K", "Potassium, K", Unit.MG, "306"),
    Component("NA", "Sodium, Na", Unit.MG, "307"),
    Component("ZN", "Zinc, Zn", Unit.MG, "309"),
    Component("CU", "Copper, Cu", Unit.MG, "312"),
    Component("MN", "Manganese, Mn", Unit.MG, "315"),
    Component("SE", "Selenium, Se", Unit.UG, "317"),
    Component("VITC", "Vitamin C, total ascorbic acid", Unit.MG, "401"),
    Component("THIA", "Thiamin", Unit.MG, "404"),
    Component("RIBF", "Riboflavin", Unit.MG, "405"),
    Component("NIA", "Niacin", Unit.MG, "406"),
    Component("PANTAC", "Pantothenic acid", Unit.MG, "410"),
    Component("VITB6A", "Vitamin B-6", Unit.MG, "415"),
    Component("FOL", "Folate, total", Unit.UG, "417"),
    Component("FOLAC", "Folic acid", Unit.UG, "431"),
    Component("FOLDFE", "Folate, DFE", Unit.UG, "435"),
    Component("VITB12", "Vitamin B-12", Unit.UG, "418"),
    Component("VITA_RAE", "Vitamin A, RAE", Unit.UG, "320"),
    Component("RETOL", "Retinol", Unit.UG, "319"),
    Component("CARTB", "Carotene, beta", Unit.UG, "321"),
    Component("TOCPHA", "Vitamin E (alpha-tocopherol)", Unit.MG, "323"),
    Component("VITD", "Vitamin D (D2 + D3)", Unit.UG, "328"),
    Component("VITK1", "Vitamin K (phylloquinone)", Unit.UG, "430"),
)

# The ten that an effective record carries as columns (design.md, "HTTP conventions").
HEADLINE_COMPONENTS: tuple[str, ...] = (
    "ENERC_KCAL",
    "PROCNT",
    "FAT",
    "CHOCDF",
    "FIBTG",
    "SUGAR",
    "FASAT",
    "NA",
    "K",
    "VITC",
)

COMPONENT_BY_TAGNAME = MappingProxyType({component.tagname: component for component in COMPONENTS})
TAGNAME_BY_SR28_NUMBER = MappingProxyType({component.sr28_number: component.tagname for component in COMPONENTS})
