"""An item's volume and its food to grams and nutrients: density chosen, refuse taken off, doubt carried on by parts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.nutrition.components import HEADLINE_COMPONENTS
from app.nutrition.density import DensityChoice, resolve_density
from app.nutrition.doubt import Doubt, Estimate
from app.nutrition.foods import Food
from app.nutrition.mass import Mass, edible_share, estimate_mass
from app.nutrition.nutrients import nutrient_amounts

RECORD_COLUMNS = dict(  # the headline components as columns of effective_record, units in their names
    zip(
        HEADLINE_COMPONENTS,
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
        strict=True,
    )
)

NO_FOOD: Mapping[str, None] = dict.fromkeys(
    ("density_g_per_ml", "density_source", "mass_g", "mass_low_g", "mass_high_g", "edible_g", *RECORD_COLUMNS.values())
)


@dataclass(frozen=True, slots=True)
class FoodAmounts:
    """What a volume of a food amounts to. nutrients: INFOODS tagname to amount in the edible mass.

    mass: None, and no nutrients, where the volume is not known.
    """

    density: DensityChoice
    mass: Mass | None
    nutrients: Mapping[str, Estimate]

    def record_columns(self) -> dict[str, float | str | None]:
        """The columns of effective_record that follow from the food."""
        chosen = self.density.chosen
        columns: dict[str, float | str | None] = {
            **NO_FOOD,
            "density_g_per_ml": chosen.g_per_ml,
            "density_source": chosen.source,
        }
        if self.mass is not None:
            seen = self.mass.as_seen_g
            columns |= {"mass_g": seen.value, "mass_low_g": seen.low, "mass_high_g": seen.high}
            columns["edible_g"] = self.mass.edible_g.value
        for tagname, column in RECORD_COLUMNS.items():
            found = self.nutrients.get(tagname)
            columns[column] = found.value if found is not None else None
        return columns


def food_amounts(food: Food, volume_ml: float | None, relative_sd: Mapping[str, float]) -> FoodAmounts:
    """Grams and nutrients of a volume; relative_sd: the volume's doubt by part ("pair", "item")."""
    density = resolve_density(food)
    if volume_ml is None:
        return FoodAmounts(density, None, {})
    doubt = Doubt(pair=relative_sd.get("pair", 0.0), item=relative_sd.get("item", 0.0))
    mass = estimate_mass(volume_ml, doubt, density.chosen, edible_share=edible_share(food))
    return FoodAmounts(density, mass, nutrient_amounts(food, mass))


def amounts_of(item: Mapping[str, Any], food: Food | None) -> dict[str, Any]:
    """What `tada estimate` adds to an item: food, grams, energy; null without a food, amounts also without a volume."""
    named = {"food": {"key": food.key, "name": food.name} if food is not None else None}
    amounts = food_amounts(food, item["volume_ml"], item["relative_sd"]) if food is not None else None
    if amounts is None or amounts.mass is None:
        return named | {"mass_g": None, "mass_interval_g": None, "edible_g": None, "energy_kcal": None}
    seen, energy = amounts.mass.as_seen_g, amounts.nutrients.get("ENERC_KCAL")
    return named | {
        "mass_g": round(seen.value, 2),
        "mass_interval_g": [round(seen.low, 2), round(seen.high, 2)],
        "edible_g": round(amounts.mass.edible_g.value, 2),
        "energy_kcal": round(energy.value, 2) if energy is not None else None,
    }
