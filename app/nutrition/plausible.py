"""Limits of possible figures: at most 100 g in 100 g, the energy of pure fat, the density of salt."""

import math
from collections.abc import Mapping

from app.core.units import Unit, convert
from app.nutrition.components import COMPONENT_BY_NUMBER, NUMBER_BY_TAGNAME, Component

LARGEST_SUM_G = 107.0  # of the macronutrients in 100 g: analysed separately, those of a salmon in SR28 add up to 106.5
LARGEST_ENERGY_KCAL = 930.0  # of 100 g; pure fat has 902 in SR28
MIN_G_PER_ML, MAX_G_PER_ML = (
    0.005,
    3.0,
)  # spun sugar has some ten times the minimum, crystals of salt 2.2

_CARBOHYDRATE = ("205", "205.2", "CHOAVLDF", "CHOAVL")  # one of them, the most inclusive first
_OTHERS = tuple(NUMBER_BY_TAGNAME[tagname] for tagname in ("WATER", "PROCNT", "FAT", "ASH", "ALC"))
_MASSES = (Unit.G, Unit.MG, Unit.UG)
_ENERGIES = (Unit.KCAL, Unit.KJ)


def most_in_100_g(component: Component) -> float:
    """Return the maximum content of a component in 100 g of any food, in its unit; infinite for international units."""
    if component.unit in _MASSES:
        return convert(100.0, Unit.G, component.unit)
    if component.unit in _ENERGIES:
        return convert(LARGEST_ENERGY_KCAL, Unit.KCAL, component.unit)
    return math.inf


def why_impossible(per_100_g: Mapping[str, float]) -> str | None:
    """Return why these contents are impossible, as a sentence; None if possible. Unknown contents count as 0."""
    for number, content in per_100_g.items():
        component = COMPONENT_BY_NUMBER.get(number)
        if component is not None and content > most_in_100_g(component):
            if component.unit in _ENERGIES:
                return f"100 g have {content:g} {component.unit}, more than pure fat: is it another unit?"
            return f"100 g hold {content:g} {component.unit} of {component.name.lower()}, more than there is."
    carbohydrate = next((per_100_g[number] for number in _CARBOHYDRATE if number in per_100_g), 0.0)
    total = math.fsum([carbohydrate, *(per_100_g.get(number, 0.0) for number in _OTHERS)])
    if total > LARGEST_SUM_G:
        return (
            f"Water, protein, fat, carbohydrate, ash and alcohol of 100 g add up to {total:.1f} g."
        )
    return None
