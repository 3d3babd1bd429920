"""Resolve recipes to versions of foods and compute the dish's figures; read them back."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.foods import queries as foods
from app.foods.component_names import component_numbers
from app.foods.edits import queries as food_changes
from app.foods.food_values import bare_value
from app.foods.models import Component, Food, FoodIngredient
from app.nutrition.foods import FoodState
from app.nutrition.recipe import Dish, Ingredient, cycle_through, prepare_dish


@dataclass(frozen=True, slots=True)
class NamedIngredient:
    """An ingredient as a client names it.

    retention: number or INFOODS tagname -> share; retention_source: where the shares are from.
    """

    food: str
    mass_g: float
    state: FoodState
    retention: Mapping[str, float]
    retention_source: str | None


@dataclass(frozen=True, slots=True)
class NamedRecipe:
    """A recipe as a client names it. recipe_yield: the dish's mass / that of its ingredients."""

    recipe_yield: float
    ingredients: Sequence[NamedIngredient]


@dataclass(frozen=True, slots=True)
class PinnedIngredient:
    """An ingredient as stored: a version of a food. retention: component number -> share."""

    food_id: int
    food_key: str
    mass_g: float
    retention: Mapping[str, float]
    retention_source: str | None


@dataclass(frozen=True, slots=True)
class PinnedRecipe:
    """A recipe whose figures never change: each ingredient is one version of a food."""

    recipe_yield: float
    ingredients: tuple[PinnedIngredient, ...]


@dataclass(frozen=True, slots=True)
class IngredientView:
    """An ingredient for readers. is_current: the food has not been corrected or replaced since."""

    food: Food
    mass_g: float
    retention: Mapping[str, float]
    retention_source: str | None
    is_current: bool


@dataclass(frozen=True, slots=True)
class RecipeView:
    """A recipe for readers.

    unknown: components that some of the ingredients lack, so that the dish has no figure, each with
    the share (0 to 1) of the ingredients' mass for which it is known.
    """

    recipe_yield: float
    ingredients: list[IngredientView]
    unknown: list[tuple[Component, float]]


def cook(session: Session, key: str, recipe: NamedRecipe) -> tuple[PinnedRecipe, Dish]:
    """Return the recipe pinned to the foods in force now, and the figures of the dish of this key.

    Raises InvalidInputError: `ingredient_unknown`, `recipe_cycle`, `component_unknown`, and what
    prepare_dish raises.
    """
    rows = _require_foods(session, [ingredient.food for ingredient in recipe.ingredients])
    cycle = cycle_through(
        key, [row.key for row in rows], food_changes.parts_of(session, [row.id for row in rows])
    )
    if cycle is not None:
        raise InvalidInputError(
            f"The dish would be an ingredient of itself: {' > '.join(cycle)}.",
            code="recipe_cycle",
            way=cycle,
        )
    pinned = PinnedRecipe(
        recipe.recipe_yield,
        tuple(
            PinnedIngredient(
                row.id,
                row.key,
                ingredient.mass_g,
                component_numbers(session, ingredient.retention),
                ingredient.retention_source,
            )
            for row, ingredient in zip(rows, recipe.ingredients, strict=True)
        ),
    )
    contents = foods.contents_of(session, {row.id for row in rows})
    ingredients = [
        Ingredient(
            replace(bare_value(row), per_100_g=contents[row.id]),
            part.mass_g,
            ingredient.state,
            part.retention,
        )
        for row, part, ingredient in zip(rows, pinned.ingredients, recipe.ingredients, strict=True)
    ]
    return pinned, prepare_dish(ingredients, recipe.recipe_yield)


def pinned_recipe(session: Session, food: Food) -> PinnedRecipe | None:
    """Return the stored recipe of this version of a food; None if it has none."""
    if food.recipe_yield is None:
        return None
    return PinnedRecipe(
        food.recipe_yield,
        tuple(
            PinnedIngredient(
                row.id,
                row.key,
                ingredient.mass_g,
                ingredient.retention,
                ingredient.retention_source,
            )
            for ingredient, row in food_changes.ingredients_of(session, food.id)
        ),
    )


def write_recipe(session: Session, food: Food, recipe: PinnedRecipe) -> None:
    """Store the recipe with a new version of a food."""
    food.recipe_yield = recipe.recipe_yield
    session.add_all(
        FoodIngredient(
            food_id=food.id,
            position=position,
            ingredient_id=part.food_id,
            mass_g=part.mass_g,
            retention=dict(part.retention),
            retention_source=part.retention_source,
        )
        for position, part in enumerate(recipe.ingredients)
    )


def read_recipe(session: Session, food: Food) -> RecipeView | None:
    """Return the recipe of this version of a food for readers; None if it has none."""
    if food.recipe_yield is None:
        return None
    ingredients = food_changes.ingredients_of(session, food.id)
    in_force = foods.foods_by_key(session, {row.key for _, row in ingredients})
    views = [
        IngredientView(
            row,
            part.mass_g,
            part.retention,
            part.retention_source,
            is_current=row.key in in_force and in_force[row.key].id == row.id,
        )
        for part, row in ingredients
    ]
    contents = foods.contents_of(session, {food.id, *(row.id for _, row in ingredients)})
    known_g: dict[str, float] = {}
    for part, row in ingredients:
        for number in contents[row.id].keys() - contents[food.id].keys():
            known_g[number] = known_g.get(number, 0.0) + part.mass_g
    total_g = sum(part.mass_g for part, _ in ingredients)
    components = sorted(
        foods.components_by_number(session).values(), key=lambda component: component.id
    )
    unknown = [
        (component, known_g[component.number] / total_g)
        for component in components
        if component.number in known_g
    ]
    return RecipeView(food.recipe_yield, views, unknown)


def _require_foods(session: Session, keys: Sequence[str]) -> list[Food]:
    by_key = foods.foods_by_key(session, set(keys))
    for key in set(keys) - by_key.keys():
        by_code = foods.foods_by_code(session, key)
        if not by_code:
            raise InvalidInputError(
                f"The food table has no food {key!r}: search it for the key.",
                code="ingredient_unknown",
                food=key,
            )
        by_key[key] = by_code[0]
    return [by_key[key] for key in keys]
