"""Household measures, such as "1 cup, sliced" of 109 g, and their volume if they are one.

Recognises the texts of USDA's tables: SR's Msre_Desc, FoodData Central's measure unit, portion
description, modifier.
"""

import math
import re
from dataclasses import dataclass

from app.core.units import Unit, density_from_portion

# Measures that start with a volume. Teaspoons are left out: their weights are rounded to a tenth of
# themselves.
_VOLUMES = (
    (re.compile(r"(?:serving )?cups?\b", re.IGNORECASE), Unit.CUP, 1.0),
    (re.compile(r"(?:serving )?1/2 cup\b", re.IGNORECASE), Unit.CUP, 0.5),
    (re.compile(r"fl\.? oz\b", re.IGNORECASE), Unit.FLUID_OUNCE, 1.0),
    (re.compile(r"(?:tbsp|tablespoons?)\b", re.IGNORECASE), Unit.TABLESPOON, 1.0),
    (re.compile(r"cubic inch(?:es)?\b", re.IGNORECASE), Unit.CUBIC_INCH, 1.0),
    (re.compile(r"(?:ml|milliliters?|millilitres?)\b", re.IGNORECASE), Unit.ML, 1.0),
)
# A cup of something other than the food: the dry food before cooking, or a drink together with its
# ice.
_NOT_THE_FOOD = re.compile(
    r"\b(?:dry|raw|uncooked|unprepared|frozen|unpopped)\b.*\byields?\b|with ice|\(NFS\)|guideline",
    re.IGNORECASE,
)
_SERVING = re.compile(r"^serving 1 (?=cup\b)")


@dataclass(frozen=True, slots=True)
class Portion:
    """`amount` of `measure` holds mass_g grams of edible food.

    sequence: the portion's number in its source.
    """

    sequence: str
    amount: float
    measure: str
    mass_g: float

    def __post_init__(self) -> None:
        if not (0.0 < self.amount < math.inf and 0.0 < self.mass_g < math.inf):
            raise ValueError(f"invalid portion: {self.amount} {self.measure} of {self.mass_g} g")

    @property
    def volume(self) -> tuple[float, Unit] | None:
        """Return the portion's volume as (amount, unit); None if the measure is not a volume (a slice)."""
        if _NOT_THE_FOOD.search(self.measure):
            return None
        measure = _SERVING.sub("", self.measure)
        for pattern, unit, size in _VOLUMES:
            if pattern.match(measure):
                return self.amount * size, unit
        return None

    @property
    def density_g_per_ml(self) -> float | None:
        """Return grams of edible portion per millilitre of the measure; None if it is not a volume."""
        volume = self.volume
        return None if volume is None else density_from_portion(self.mass_g, *volume)
