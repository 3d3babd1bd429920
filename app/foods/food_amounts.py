"""Turn an item's volume into grams and nutrients: choose a density, subtract refuse, propagate uncertainty by part."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.nutrition.components import HEADLINE_BY_COLUMN, HEADLINE_COLUMNS
from app.nutrition.density import DensityChoice, resolve_density
from app.nutrition.doubt import Doubt, Estimate
from app.nutrition.foods import Density, Food, FoodForm, food_form
from app.nutrition.mass import AFTER, BEFORE, Mass, consumed_mass, edible_share, estimate_mass
from app.nutrition.nutrients import Portion, nutrients_in

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
        *HEADLINE_COLUMNS,
    )
)


@dataclass(frozen=True, slots=True)
class Weighing:
    """How an item's volume becomes grams: the chosen density (None: none is known) and the edible share."""

    density: Density | None
    edible_share: float


@dataclass(frozen=True, slots=True)
class FoodAmounts:
    """Grams and nutrients of one helping of a food.

    weighing: converts its volume to grams; has no density if a person entered the grams. per_100_g:
    component number -> content of 100 g edible portion. mass: as served; None if the volume or the
    density is not known, and then the fields below are empty too. left: leftovers; None: not
    assessed. share: the person's share of a shared dish. consumed_g: edible grams eaten, signed;
    None if the leftovers' mass is not known. nutrients: component number -> amount eaten.
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
        """Return the value of a headline component; None if it is not known."""
        amount = HEADLINE_BY_COLUMN[column].best_of(self.nutrients)
        return amount.value if amount is not None else None

    def record_columns(self) -> dict[str, float | str | None]:
        """Return the columns of effective_record that are derived from the food."""
        columns: dict[str, float | str | None] = {**NO_FOOD}
        if self.weighing.density is not None:
            chosen = self.weighing.density
            columns |= {"density_g_per_ml": chosen.g_per_ml, "density_source": chosen.source}
        if self.mass is not None:
            as_seen_g = self.mass.as_seen_g
            columns |= {
                "mass_g": as_seen_g.value,
                "mass_low_g": as_seen_g.low,
                "mass_high_g": as_seen_g.high,
            }
            columns["edible_g"] = self.mass.edible_g.value
        if self.left is not None:
            columns["left_g"] = math.fsum(mass.edible_g.value for mass in self.left)
        if self.consumed_g is not None:
            eaten = self.consumed_g
            columns |= {
                "consumed_g": eaten.value,
                "consumed_low_g": eaten.low,
                "consumed_high_g": eaten.high,
            }
        return columns | {column: self.headline(column) for column in HEADLINE_COLUMNS}

    def portions(self) -> list[Portion]:
        """Return the terms of the amount eaten: what was served, and minus each leftover.

        If the amount eaten is not known, return one portion without a mass.
        """
        if self.consumed_g is None:
            return [Portion(self.food_key, self.per_100_g, None, BEFORE)]
        served = Portion(self.food_key, self.per_100_g, self.mass, BEFORE, share=self.share)
        left = [
            Portion(self.food_key, self.per_100_g, mass, AFTER, -1, self.share)
            for mass in self.left or ()
        ]
        return [served, *left]


def weigh(food: Food, choice: DensityChoice | None, lies_as: FoodForm | None) -> Weighing:
    """Return how an item of this food is weighed; lies_as: its form on the plate (None: its usual form)."""
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
    """Return grams and nutrients of a helping.

    per_100_g: component number -> content. mass: as served. left: mass of each leftover piece; an
    entry of None (mass not known) makes the amount eaten unknown too. left=None: leftovers were not
    assessed, and all counts as eaten.
    """
    measured = tuple(piece for piece in left or () if piece is not None)
    is_left_known = left is None or len(measured) == len(left)
    consumed_g = None
    if mass is not None and is_left_known:
        consumed_g = consumed_mass(mass, measured, food_key=food_key, share=share)
    return FoodAmounts(
        food_key=food_key,
        per_100_g=per_100_g,
        weighing=weighing,
        mass=mass,
        left=measured if left is not None and is_left_known else None,
        share=share,
        consumed_g=consumed_g,
        nutrients=nutrients_in(per_100_g, consumed_g) if consumed_g is not None else {},
    )


def mass_of(
    weighing: Weighing, volume_ml: float | None, relative_sd: Mapping[str, float]
) -> Mass | None:
    """Return the mass of a volume; None if it or the density is not known.

    relative_sd: the volume's doubt by part.
    """
    if volume_ml is None or weighing.density is None:
        return None
    doubt = Doubt(pair=relative_sd.get("pair", 0.0), item=relative_sd.get("item", 0.0))
    return estimate_mass(volume_ml, doubt, weighing.density, edible_share=weighing.edible_share)


def amounts_of(
    item: Mapping[str, Any], food: Food | None, lies_as: str | None = None
) -> dict[str, object]:
    """Return the fields that `tada estimate` adds to an item: food, grams, energy; null where they are not known."""
    food_ref: dict[str, object] = {
        "food": {"key": food.key, "name": food.name} if food is not None else None
    }
    unknown: dict[str, object] = dict.fromkeys(
        ("mass_g", "mass_interval_g", "edible_g", "energy_kcal")
    )
    if food is None:
        return food_ref | unknown
    form = food_form(lies_as)
    weighing = weigh(food, resolve_density(food, form=form), form)
    mass = mass_of(weighing, item["volume_ml"], item["relative_sd"])
    amounts = food_amounts(food.key, food.per_100_g, weighing, mass)
    if amounts.mass is None:
        return food_ref | unknown
    as_seen_g, energy_kcal = amounts.mass.as_seen_g, amounts.headline("energy_kcal")
    return food_ref | {
        "mass_g": round(as_seen_g.value, 2),
        "mass_interval_g": [round(as_seen_g.low, 2), round(as_seen_g.high, 2)],
        "edible_g": round(amounts.mass.edible_g.value, 2),
        "energy_kcal": round(energy_kcal, 2) if energy_kcal is not None else None,
    }
