"""An item's volume and its food to grams and nutrients: density chosen, refuse taken off, doubt carried on by parts."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.nutrition.components import HEADLINE_NUMBERS
from app.nutrition.density import DensityChoice, resolve_density
from app.nutrition.doubt import Doubt, Estimate
from app.nutrition.foods import Density, Food, FoodForm, food_form
from app.nutrition.mass import AFTER, BEFORE, Mass, consumed_mass, edible_share, estimate_mass
from app.nutrition.nutrients import Portion, nutrients_in

# The names stand here and in meals/record_models.py (a test compares): `tada estimate` loads no database.
RECORD_COLUMNS = dict(  # columns of effective_record, units in their names -> component numbers, the best first
    zip(
        (
            "energy_kcal",
            "protein_g",
            "fat_g",
            "carbohydrate_g",
            "fibre_g",
            "sugar_g",
            "saturated_fat_g",
            "sodium_mg",
            "potassium_mg",
            "vitamin_c_mg",
        ),
        HEADLINE_NUMBERS,
        strict=True,
    )
)

NO_FOOD: Mapping[str, None] = dict.fromkeys(
    (
        "density_g_per_ml",
        "density_source",
        "mass_g",
        "mass_low_g",
        "mass_high_g",
        "edible_g",
        "left_g",
        "consumed_g",
        "consumed_low_g",
        "consumed_high_g",
        *RECORD_COLUMNS,
    )
)


@dataclass(frozen=True, slots=True)
class Weighing:
    """What turns an item's volume into grams: the density that was chosen (None: none is known), the edible share."""

    density: Density | None
    edible_share: float


@dataclass(frozen=True, slots=True)
class FoodAmounts:
    """What a helping of a food amounts to.

    weighing: what turns its volume into grams; without a density where a person set the grams. per_100_g: component
    number -> content of 100 g edible portion. mass: as served; None, and nothing after it, where the volume or the
    density is not known. left: what was left of it; None: nobody has looked. share: the person's, of a dish that is
    shared. consumed_g: edible grams eaten, signed; None where what was left cannot be told. nutrients: component number
    -> amount in what was eaten.
    """

    food_key: str
    per_100_g: Mapping[str, float]
    weighing: Weighing
    mass: Mass | None
    left: tuple[Mass, ...] | None
    share: float
    consumed_g: Estimate | None
    nutrients: Mapping[str, Estimate]

    def headline(self, column: str) -> float | None:
        """One of RECORD_COLUMNS; None where it is not known."""
        known = [self.nutrients[number] for number in RECORD_COLUMNS[column] if number in self.nutrients]
        return known[0].value if known else None

    def record_columns(self) -> dict[str, float | str | None]:
        """The columns of effective_record that follow from the food."""
        columns: dict[str, float | str | None] = {**NO_FOOD}
        if self.weighing.density is not None:
            chosen = self.weighing.density
            columns |= {"density_g_per_ml": chosen.g_per_ml, "density_source": chosen.source}
        if self.mass is not None:
            seen = self.mass.as_seen_g
            columns |= {"mass_g": seen.value, "mass_low_g": seen.low, "mass_high_g": seen.high}
            columns["edible_g"] = self.mass.edible_g.value
        if self.left is not None:
            columns["left_g"] = math.fsum(one.edible_g.value for one in self.left)
        if self.consumed_g is not None:
            eaten = self.consumed_g
            columns |= {"consumed_g": eaten.value, "consumed_low_g": eaten.low, "consumed_high_g": eaten.high}
        return columns | {column: self.headline(column) for column in RECORD_COLUMNS}

    def portions(self) -> list[Portion]:
        """What was eaten as terms of a total: what was served, and taken away what was left.

        Where what was eaten is not known, one portion without a mass.
        """
        if self.consumed_g is None:
            return [Portion(self.food_key, self.per_100_g, None, BEFORE)]
        served = Portion(self.food_key, self.per_100_g, self.mass, BEFORE, share=self.share)
        left = [Portion(self.food_key, self.per_100_g, one, AFTER, -1, self.share) for one in self.left or ()]
        return [served, *left]


def weigh(food: Food, choice: DensityChoice | None, lies_as: FoodForm | None) -> Weighing:
    """How an item of this food is weighed; lies_as: in which form it lies (None: as it usually does)."""
    return Weighing(choice.chosen if choice is not None else None, edible_share(food, form=lies_as))


def food_amounts(
    food_key: str,
    per_100_g: Mapping[str, float],
    weighing: Weighing,
    mass: Mass | None,
    *,
    left: Sequence[Mass | None] | None = None,
    share: float = 1.0,
) -> FoodAmounts:
    """Grams and nutrients of a helping.

    per_100_g: component number -> content. mass: as served. left: what was left, None in it where the mass of a piece
    is not known, and with it what was eaten; None for all of it: nobody has looked, and all was eaten as far as known.
    """
    measured = tuple(one for one in left or () if one is not None)
    is_told = left is None or len(measured) == len(left)
    consumed_g = consumed_mass(mass, measured, food_key=food_key, share=share) if mass is not None and is_told else None
    return FoodAmounts(
        food_key=food_key,
        per_100_g=per_100_g,
        weighing=weighing,
        mass=mass,
        left=measured if left is not None and is_told else None,
        share=share,
        consumed_g=consumed_g,
        nutrients=nutrients_in(per_100_g, consumed_g) if consumed_g is not None else {},
    )


def mass_of(weighing: Weighing, volume_ml: float | None, relative_sd: Mapping[str, float]) -> Mass | None:
    """Grams of a volume; None where it, or the density, is not known. relative_sd: the volume's doubt by part."""
    if volume_ml is None or weighing.density is None:
        return None
    doubt = Doubt(pair=relative_sd.get("pair", 0.0), item=relative_sd.get("item", 0.0))
    return estimate_mass(volume_ml, doubt, weighing.density, edible_share=weighing.edible_share)


def amounts_of(item: Mapping[str, Any], food: Food | None, lies_as: str | None = None) -> dict[str, object]:
    """What `tada estimate` adds to an item: food, grams, energy; null without a food, amounts also without a volume."""
    named: dict[str, object] = {"food": {"key": food.key, "name": food.name} if food is not None else None}
    unknown: dict[str, object] = dict.fromkeys(("mass_g", "mass_interval_g", "edible_g", "energy_kcal"))
    if food is None:
        return named | unknown
    form = food_form(lies_as)
    weighing = weigh(food, resolve_density(food, form=form), form)
    mass = mass_of(weighing, item["volume_ml"], item["relative_sd"])
    amounts = food_amounts(food.key, food.per_100_g, weighing, mass)
    if amounts.mass is None:
        return named | unknown
    seen, energy_kcal = amounts.mass.as_seen_g, amounts.headline("energy_kcal")
    return named | {
        "mass_g": round(seen.value, 2),
        "mass_interval_g": [round(seen.low, 2), round(seen.high, 2)],
        "edible_g": round(amounts.mass.edible_g.value, 2),
        "energy_kcal": round(energy_kcal, 2) if energy_kcal is not None else None,
    }
