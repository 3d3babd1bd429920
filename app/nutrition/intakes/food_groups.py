"""Recommendations of grams a day by food group, of WHO and EAT-Lancet."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

from app.nutrition.intakes.life_stage import check_age
from app.nutrition.packaged_rows import packaged_rows

FoodGroup = Literal[
    "fruit", "fruit_juice", "dried_fruit", "vegetables", "vegetable_juice", "starchy_tubers", "legumes", "soy", "nuts",
    "grains", "milk", "cheese", "eggs", "beef_lamb", "pork", "poultry", "fish", "processed_meat", "dairy_fat",
    "palm_oil", "unsaturated_oils", "lard_tallow", "sugars", "beverages",
]  # fmt: skip
Basis = Literal["as_eaten", "dry", "milk_equivalent"]

FOOD_GROUPS: tuple[FoodGroup, ...] = get_args(FoodGroup)
BASES: tuple[Basis, ...] = get_args(Basis)


@dataclass(frozen=True, slots=True)
class Recommendation:
    """Grams per day of one or several groups together: at least low_g, at most high_g, target_g in the source's diet.

    basis: what the grams refer to; only those of food as eaten compare with what a camera sees. note: caveats.
    """

    source: str
    name: str
    groups: tuple[FoodGroup, ...]
    low_g: float | None
    target_g: float | None
    high_g: float | None
    basis: Basis
    note: str


def recommendations(age_years: float) -> tuple[Recommendation, ...]:
    """Return the recommendations for this age: WHO from 2 years, EAT-Lancet for adults. Raises ValueError."""
    check_age(age_years)
    return tuple(
        recommendation
        for from_years, below_years, recommendation in _all()
        if from_years <= age_years < below_years
    )


@cache
def _all() -> tuple[tuple[float, float, Recommendation], ...]:
    return tuple(
        (float(row["from_years"]), float(row["below_years"] or "inf"), _recommendation(row))
        for row in packaged_rows("reference", "food_group_recommendations.csv")
    )


def _recommendation(row: Mapping[str, str]) -> Recommendation:
    return Recommendation(
        source=row["source"],
        name=row["name"],
        groups=tuple(group for group in FOOD_GROUPS if group in row["groups"].split()),
        low_g=float(row["low_g"]) if row["low_g"] else None,
        target_g=float(row["target_g"]) if row["target_g"] else None,
        high_g=float(row["high_g"]) if row["high_g"] else None,
        basis=next(basis for basis in BASES if basis == row["basis"]),
        note=row["note"],
    )
