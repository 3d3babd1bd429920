"""All unit conversions: volumes, masses and energies; converting between quantities raises.

A volume is never converted to a mass here: that needs a density (nutrition/mass.py). International
units (IU) are not converted: their size depends on the vitamin and its form.
"""

import math
from enum import StrEnum
from typing import Literal

Quantity = Literal["volume", "mass", "energy", "activity"]

KJ_PER_KCAL = 4.184  # thermochemical calorie, as INFOODS and USDA use it


class Unit(StrEnum):
    """A unit of figures in this system. Cup, fluid ounce and spoons are the US customary ones."""

    MM3 = "mm3"
    ML = "ml"
    CUBIC_INCH = "in3"
    CUP = "cup"
    FLUID_OUNCE = "fl_oz"
    TABLESPOON = "tbsp"
    TEASPOON = "tsp"
    G = "g"
    MG = "mg"
    UG = "ug"
    KCAL = "kcal"
    KJ = "kJ"
    IU = "IU"


# Size in the base unit of the quantity: ml, g, kcal. The inch is 25.4 mm by definition, a US gallon
# is 231 cubic inches = 16 cups = 128 fluid ounces = 256 tablespoons = 768 teaspoons (NIST Handbook
# 44, appendix C).
_CUBIC_INCH_ML = 25.4**3 / 1000.0
_SIZES: dict[Unit, tuple[Quantity, float]] = {
    Unit.MM3: ("volume", 1e-3),
    Unit.ML: ("volume", 1.0),
    Unit.CUBIC_INCH: ("volume", _CUBIC_INCH_ML),
    Unit.CUP: ("volume", 231.0 / 16.0 * _CUBIC_INCH_ML),
    Unit.FLUID_OUNCE: ("volume", 231.0 / 128.0 * _CUBIC_INCH_ML),
    Unit.TABLESPOON: ("volume", 231.0 / 256.0 * _CUBIC_INCH_ML),
    Unit.TEASPOON: ("volume", 231.0 / 768.0 * _CUBIC_INCH_ML),
    Unit.G: ("mass", 1.0),
    Unit.MG: ("mass", 1e-3),
    Unit.UG: ("mass", 1e-6),
    Unit.KCAL: ("energy", 1.0),
    Unit.KJ: ("energy", 1.0 / KJ_PER_KCAL),
    Unit.IU: ("activity", 1.0),
}


class UnitMismatchError(ValueError):
    """The two units measure different quantities, so there is no conversion factor."""


def convert(value: float, source: Unit, target: Unit) -> float:
    """Convert a value from `source` units to `target` units.

    Raises UnitMismatchError if they measure different quantities.
    """
    source_quantity, source_size = _SIZES[source]
    target_quantity, target_size = _SIZES[target]
    if source_quantity != target_quantity:
        raise UnitMismatchError(
            f"{source} measures {source_quantity}, {target} measures {target_quantity}"
        )
    return value * source_size / target_size


def ml_from_mm3(volume_mm3: float) -> float:
    """Convert cubic millimetres to millilitres."""
    return convert(volume_mm3, Unit.MM3, Unit.ML)


def kj_from_kcal(energy_kcal: float) -> float:
    """Convert kilocalories to kilojoules (x 4.184)."""
    return convert(energy_kcal, Unit.KCAL, Unit.KJ)


def density_from_portion(mass_g: float, measure: float, unit: Unit) -> float:
    """Return the density, g/ml, of a portion of `mass_g` grams that fills `measure` units of volume (half a cup ...).

    Raises UnitMismatchError if the unit is not a volume, ValueError if mass or measure is not
    positive and finite.
    """
    volume_ml = convert(measure, unit, Unit.ML)
    if not (0.0 < mass_g < math.inf and 0.0 < volume_ml < math.inf):
        raise ValueError(
            f"a portion has a positive mass and volume, not {mass_g} g in {measure} {unit}"
        )
    return mass_g / volume_ml


def content_of_mass(per_100_g: float, mass_g: float) -> float:
    """Return the amount of a component in `mass_g` grams, in the unit of its content `per_100_g`."""
    return per_100_g * mass_g / 100.0
