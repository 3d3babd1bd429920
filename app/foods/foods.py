"""Read one food of the tables in force, with its details and the chosen density."""

import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.core.errors import NotFoundError
from app.db.session import Database
from app.foods import queries as foods
from app.foods.food_values import choose_density, food_value, own_densities
from app.foods.models import Food, FoodRelease
from app.foods.queries import NutrientRow, foods_by_key
from app.foods.recipes import RecipeView, read_recipe
from app.nutrition.density import DensityChoice
from app.nutrition.foods import Density
from app.nutrition.foods import Food as FoodValue
from app.nutrition.mass import edible_share


@dataclass(frozen=True, slots=True)
class FoodView:
    """A food with its nutrients per 100 g edible and the release it is of.

    density is chosen from value.densities, with its alternatives; None if none is known.
    own_densities: the food's own. recipe: None for a food that was not made from one.
    """

    food: Food
    value: FoodValue
    release: str
    own_densities: Sequence[Density]
    density: DensityChoice | None
    edible_share: float
    nutrients: list[NutrientRow]
    recipe: RecipeView | None


def read_food(database: Database, key: str, study_id: uuid.UUID | None = None) -> FoodView:
    """Return one food in force, by its key or its number in a published table.

    Raises NotFoundError.

    study_id: the study whose own density measurements count.
    """
    with database.read() as session:
        return view_of(session, require_food(session, key), study_id)


def require_food(session: Session, key: str) -> Food:
    """Return the food in force with this key, or with this number in a published table.

    Raises NotFoundError.
    """
    food = foods.foods_by_key(session, [key]).get(key)
    if food is not None:
        return food
    by_code = foods.foods_by_code(session, key)
    if not by_code:
        raise NotFoundError(
            f"The food table has no food {key!r}: search it for the key.", code="food_not_found"
        )
    return by_code[0]


def view_of(session: Session, food: Food, study_id: uuid.UUID | None) -> FoodView:
    """Return a food with its details."""
    value = food_value(session, food)
    return FoodView(
        food=food,
        value=value,
        release=session.get_one(FoodRelease, food.release_id).title,
        own_densities=own_densities(session, food),
        density=choose_density(session, value, study_id),
        edible_share=edible_share(value),
        nutrients=foods.nutrients_of(session, food.id),
        recipe=read_recipe(session, food),
    )


def food_names(database: Database, keys: Collection[str]) -> dict[str, str]:
    """Return key -> name, for the keys that exist."""
    if not keys:
        return {}
    with database.read() as session:
        return {key: food.name for key, food in foods_by_key(session, keys).items()}
