"""What a food would weigh a millilitre without any pore or bubble, from its composition.

Choi and Okos, "Effects of temperature and composition on the thermal properties of foods", in Food Engineering and
Process Applications, vol. 1 (1986): the density of each constituent as a function of the temperature; volumes add up.
Right for meat, cheese, sauces and sweets; for bread and whole fruit, which hold air, an upper bound.
"""

from collections.abc import Mapping
from types import MappingProxyType

# At 20 C, g/ml, by SR28's nutrient number: water, protein, fat, carbohydrate, fibre; ethanol from the same temperature.
_WATER, _PROTEIN, _FAT, _CARBOHYDRATE, _FIBER, _ALCOHOL = "255", "203", "204", "205", "291", "221"
_G_PER_ML = MappingProxyType(
    {
        _WATER: 0.9957,
        _PROTEIN: 1.3195,
        _FAT: 0.9172,
        _CARBOHYDRATE: 1.5929,
        _FIBER: 1.3042,
        _ALCOHOL: 0.7893,
    }
)
_ASH_G_PER_ML = 2.4182


def pore_free_density(per_100_g: Mapping[str, float]) -> float | None:
    """Component number -> content of 100 g, to g/ml at 20 C; None where water, protein, fat or carbohydrate is unknown.

    Carbohydrate is by difference, so that ash is what the others leave of 100 g, and contains the fibre.
    """
    if any(number not in per_100_g for number in (_WATER, _PROTEIN, _FAT, _CARBOHYDRATE)):
        return None
    grams = {number: per_100_g.get(number, 0.0) for number in _G_PER_ML}
    ash_g = max(0.0, 100.0 - sum(grams.values()) + grams[_FIBER])
    grams[_CARBOHYDRATE] = max(0.0, grams[_CARBOHYDRATE] - grams[_FIBER])
    volume_ml = sum(grams[number] / _G_PER_ML[number] for number in grams) + ash_g / _ASH_G_PER_ML
    return (sum(grams.values()) + ash_g) / volume_ml
