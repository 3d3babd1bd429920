"""A dish's composition from its recipe: ingredients, yield and retention -> content of 100 g of the dish as eaten.

The "mixed" method of FAO/INFOODS, which EuroFIR recommends: yield at the recipe's level, retention
at each ingredient's level (Vasquez-Caicedo, Bell and Hartmann, EuroFIR D2.2.9, 2008; Bognar and
Piekarski, J. Food Compos. Anal. 13 (2000) 391). With ingredients of m_i grams that contain c_i per
100 g and retain the share r_i, and a dish of Y sum(m_i) grams,

    100 g of the dish contain sum(m_i c_i r_i) / (Y sum(m_i)).

Water has no factor but follows from the masses: the weight that the dish loses against its
ingredients is water, except for the fat, alcohol, protein, carbohydrate and ash lost by retention.
Energy falls by the energy of what is lost. The caller gives all factors; none is assumed here.
Contents that an ingredient lacks are unknown for the dish, never 0.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from app.core.errors import InvalidInputError
from app.core.units import content_of_mass, kj_from_kcal
from app.nutrition.components import (
    COMPONENT_BY_NUMBER,
    ENERGY_NUMBERS,
    NUMBER_BY_TAGNAME,
    is_fatty_acid,
)
from app.nutrition.foods import Food, FoodState

WATER = NUMBER_BY_TAGNAME["WATER"]
FAT = NUMBER_BY_TAGNAME["FAT"]
KILOJOULES = NUMBER_BY_TAGNAME["ENERC_KJ"]
# computed from the others, so they take no factor
DERIVED = frozenset({WATER, KILOJOULES, *ENERGY_NUMBERS})

# kcal/g of the constituents of a food beside water: the Atwater general factors (FAO Food and
# Nutrition Paper 77, 2003); 0 for ash. They apply only to what cooking removes.
_KCAL_PER_G = MappingProxyType(
    {
        NUMBER_BY_TAGNAME["PROCNT"]: 4.0,
        FAT: 9.0,
        NUMBER_BY_TAGNAME["CHOCDF"]: 4.0,
        NUMBER_BY_TAGNAME["ALC"]: 7.0,
        NUMBER_BY_TAGNAME["ASH"]: 0.0,
    }
)
_WATER_SLACK_G = 1.0  # in 100 g: published figures do not add up to 100 exactly


@dataclass(frozen=True, slots=True)
class Ingredient:
    """Edible grams of a food in the state in which it goes into the dish.

    retention: component number -> share (0 to 1) left after cooking; 1 if not given, except that a
    fatty acid takes the share of the fat. Only for food that is not cooked yet.
    """

    food: Food
    mass_g: float
    state: FoodState
    retention: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Dish:
    """Contents of a dish.

    per_100_g: component number -> content of 100 g as eaten, of the components known for all
    ingredients. coverage: component number -> the share (0 to 1) of the ingredients' mass for which
    it is known, for every component known for at least one of them; 1 for those in per_100_g.
    """

    per_100_g: Mapping[str, float]
    coverage: Mapping[str, float]


def prepare_dish(ingredients: Sequence[Ingredient], recipe_yield: float) -> Dish:
    """Return the dish of these ingredients.

    recipe_yield: its mass / theirs, below 1 if water boils off.

    Raises InvalidInputError: `ingredient_state_differs` (raw and cooked are never interchangeable),
    `ingredient_is_cooked` (retention or a yield for food that is cooked already),
    `retention_invalid`, `recipe_impossible` (it loses more water than there is); ValueError if
    there is no ingredient or a mass, yield or share is invalid.
    """
    _check_values(ingredients, recipe_yield)
    for ingredient in ingredients:
        _check_ingredient(ingredient)
    if recipe_yield != 1.0 and all(ingredient.state == "cooked" for ingredient in ingredients):
        raise InvalidInputError(
            "All ingredients are cooked already, so no yield applies: leave it at 1.",
            code="ingredient_is_cooked",
        )
    total_g = math.fsum(ingredient.mass_g for ingredient in ingredients)
    contents: dict[str, float] = {}
    coverage: dict[str, float] = {}
    for number in dict.fromkeys(n for n in (*COMPONENT_BY_NUMBER, *_other_numbers(ingredients))):
        amounts = [_amount(ingredient, number) for ingredient in ingredients]
        known_g = math.fsum(
            i.mass_g for i, amount in zip(ingredients, amounts, strict=True) if amount is not None
        )
        known_amounts = [amount for amount in amounts if amount is not None]
        if known_amounts:
            coverage[number] = 1.0 if len(known_amounts) == len(amounts) else known_g / total_g
        if len(known_amounts) == len(amounts):
            total = math.fsum(known_amounts) + (
                (recipe_yield - 1.0) * total_g if number == WATER else 0.0
            )
            contents[number] = 100.0 * total / (recipe_yield * total_g)
    if contents.get(WATER, 0.0) < -_WATER_SLACK_G:
        raise InvalidInputError(
            f"A yield of {recipe_yield:g} removes more water from the ingredients than they contain.",
            code="recipe_impossible",
        )
    return Dish(
        MappingProxyType({number: max(0.0, content) for number, content in contents.items()}),
        MappingProxyType(coverage),
    )


def cycle_through(
    key: str, ingredients: Collection[str], parts: Mapping[str, Collection[str]]
) -> list[str] | None:
    """Return the path by which a dish of these ingredients would contain itself, from `key` to `key`, or None.

    parts: food key -> the keys of its ingredients, for every reachable food.
    """
    paths = [[key, ingredient] for ingredient in ingredients]
    visited: set[str] = set()
    while paths:
        path = paths.pop()
        if path[-1] == key:
            return path
        if path[-1] not in visited:
            visited.add(path[-1])
            paths.extend([*path, part] for part in parts.get(path[-1], ()))
    return None


def _check_values(ingredients: Sequence[Ingredient], recipe_yield: float) -> None:
    if not ingredients:
        raise ValueError("a recipe has ingredients")
    if not 0.0 < recipe_yield < math.inf:
        raise ValueError(f"a yield is positive and finite, not {recipe_yield}")
    for ingredient in ingredients:
        if not 0.0 < ingredient.mass_g < math.inf:
            raise ValueError(
                f"{ingredient.food.key}: a mass is positive and finite, not {ingredient.mass_g} g"
            )
        if any(not 0.0 <= share <= 1.0 for share in ingredient.retention.values()):
            raise ValueError(f"{ingredient.food.key}: a retention is a share from 0 to 1")


def _check_ingredient(ingredient: Ingredient) -> None:
    food = ingredient.food
    if food.state != ingredient.state:
        table_state = f"is {food.state}" if food.state else "has no state"
        raise InvalidInputError(
            f"{food.key!r} {table_state} in the food table, and the recipe takes it {ingredient.state}: choose the "
            "food in the state in which it was weighed. Raw and cooked are never interchangeable.",
            code="ingredient_state_differs",
            food=food.key,
        )
    if ingredient.state == "cooked" and ingredient.retention:
        raise InvalidInputError(
            f"{food.key!r} is cooked already: its figures are those after cooking, so no retention applies.",
            code="ingredient_is_cooked",
            food=food.key,
        )
    derived = sorted(DERIVED & ingredient.retention.keys())
    if derived:
        name = COMPONENT_BY_NUMBER[derived[0]].name.lower()
        raise InvalidInputError(
            f"{food.key!r}: {name} takes no retention factor: it is computed from the masses and the other losses.",
            code="retention_invalid",
            food=food.key,
            component=derived[0],
        )


def _other_numbers(ingredients: Sequence[Ingredient]) -> list[str]:
    return [number for ingredient in ingredients for number in ingredient.food.per_100_g]


def _amount(ingredient: Ingredient, number: str) -> float | None:
    """Return the amount of a component left in the ingredient, in its unit; None if not known.

    Water: before yield.
    """
    content = ingredient.food.per_100_g.get(number)
    if content is None:
        return None
    amount = content_of_mass(content, ingredient.mass_g)
    if number not in DERIVED:
        return amount * _share_kept(ingredient, number)
    lost_g = _lost_g(ingredient)
    if lost_g is None:
        return None
    if number == WATER:
        return amount + math.fsum(lost_g.values())
    lost_kcal = math.fsum(
        grams * _KCAL_PER_G[macronutrient] for macronutrient, grams in lost_g.items()
    )
    return max(0.0, amount - (kj_from_kcal(lost_kcal) if number == KILOJOULES else lost_kcal))


def _share_kept(ingredient: Ingredient, number: str) -> float:
    share = ingredient.retention.get(number)
    if share is not None:
        return share
    component = COMPONENT_BY_NUMBER.get(number)
    shares_fate_of_fat = component is not None and is_fatty_acid(component.name)
    return ingredient.retention.get(FAT, 1.0) if shares_fate_of_fat else 1.0


def _lost_g(ingredient: Ingredient) -> dict[str, float] | None:
    """Return the grams of each macronutrient lost by retention; None if the content of one is not known."""
    lost: dict[str, float] = {}
    for number in _KCAL_PER_G.keys() & ingredient.retention.keys():
        if ingredient.retention[number] == 1.0:
            continue
        content = ingredient.food.per_100_g.get(number)
        if content is None:
            return None
        lost[number] = content_of_mass(content, ingredient.mass_g) * (
            1.0 - ingredient.retention[number]
        )
    return lost
