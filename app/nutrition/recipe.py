"""A dish's composition from its recipe: ingredients, yield and retention -> content of 100 g of the dish as eaten.

The method that FAO/INFOODS teaches as the mixed one and EuroFIR recommends: the yield at the recipe's level, retention
at each ingredient's (Vasquez-Caicedo, Bell and Hartmann, EuroFIR D2.2.9, 2008; Bognar and Piekarski, J. Food Compos.
Anal. 13 (2000) 391). With ingredients of m_i grams that hold c_i per 100 g and keep the share r_i, and a dish of Y
sum(m_i) grams,

    100 g of the dish hold sum(m_i c_i r_i) / (Y sum(m_i)).

Water has no factor, it follows from the masses: what the dish weighs less than its ingredients is water, but for the
fat, alcohol, protein, carbohydrate and ash that a retention says are lost. Energy falls by what those would have given.
Factors are the caller's; none is made up here. Figures that an ingredient lacks are unknown for the dish, never 0.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from app.core.errors import InvalidInputError
from app.core.units import content_of_mass, kj_from_kcal
from app.nutrition.components import COMPONENT_BY_NUMBER, ENERGY_NUMBERS, NUMBER_BY_TAGNAME, is_fatty_acid
from app.nutrition.foods import Food, FoodState

WATER = NUMBER_BY_TAGNAME["WATER"]
FAT = NUMBER_BY_TAGNAME["FAT"]
KILOJOULES = NUMBER_BY_TAGNAME["ENERC_KJ"]
DERIVED = frozenset({WATER, KILOJOULES, *ENERGY_NUMBERS})  # they follow from the rest, so no factor is theirs

# kcal/g of what makes up a food's mass beside water: the Atwater general factors (FAO Food and Nutrition Paper 77,
# 2003); 0 for ash. They price only what cooking takes away.
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

    retention: component number -> share (0 to 1) that cooking leaves; 1 where not named, but a fatty acid shares the
    fate of the fat. Only of food that is not cooked yet.
    """

    food: Food
    mass_g: float
    state: FoodState
    retention: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Dish:
    """What the recipe gives.

    per_100_g: component number -> content of 100 g as eaten, of the components that all ingredients know. coverage:
    component number -> the share (0 to 1) of the ingredients' mass of which it is known, for every component that at
    least one of them knows; 1 for those in per_100_g.
    """

    per_100_g: Mapping[str, float]
    coverage: Mapping[str, float]


def prepare_dish(ingredients: Sequence[Ingredient], recipe_yield: float) -> Dish:
    """The dish of these ingredients. recipe_yield: its mass / theirs, below 1 where water boils off.

    Raises InvalidInputError: `ingredient_state_differs` (raw and cooked are never interchangeable),
    `ingredient_is_cooked` (retention or a yield asked of what is cooked already), `retention_invalid`,
    `recipe_impossible` (it loses more water than there is); ValueError if there is no ingredient or a mass, yield or
    share cannot be.
    """
    _check_values(ingredients, recipe_yield)
    for ingredient in ingredients:
        _check_ingredient(ingredient)
    if recipe_yield != 1.0 and all(ingredient.state == "cooked" for ingredient in ingredients):
        raise InvalidInputError(
            "All ingredients are cooked already, so no yield applies: leave it at 1.", code="ingredient_is_cooked"
        )
    whole_g = math.fsum(ingredient.mass_g for ingredient in ingredients)
    contents: dict[str, float] = {}
    coverage: dict[str, float] = {}
    for number in dict.fromkeys(n for n in (*COMPONENT_BY_NUMBER, *_other_numbers(ingredients))):
        amounts = [_amount(ingredient, number) for ingredient in ingredients]
        known_g = math.fsum(i.mass_g for i, amount in zip(ingredients, amounts, strict=True) if amount is not None)
        known = [amount for amount in amounts if amount is not None]
        if known:
            coverage[number] = 1.0 if len(known) == len(amounts) else known_g / whole_g
        if len(known) == len(amounts):
            total = math.fsum(known) + ((recipe_yield - 1.0) * whole_g if number == WATER else 0.0)
            contents[number] = 100.0 * total / (recipe_yield * whole_g)
    if contents.get(WATER, 0.0) < -_WATER_SLACK_G:
        raise InvalidInputError(
            f"A yield of {recipe_yield:g} takes more water out of the ingredients than they have.",
            code="recipe_impossible",
        )
    return Dish(
        MappingProxyType({number: max(0.0, content) for number, content in contents.items()}),
        MappingProxyType(coverage),
    )


def cycle_through(key: str, ingredients: Collection[str], parts: Mapping[str, Collection[str]]) -> list[str] | None:
    """The way by which a dish of these ingredients would contain itself, from `key` to `key`; None if it does not.

    parts: food key -> the keys of what it is made of, for every food that can be reached.
    """
    ways = [[key, ingredient] for ingredient in ingredients]
    seen: set[str] = set()
    while ways:
        way = ways.pop()
        if way[-1] == key:
            return way
        if way[-1] not in seen:
            seen.add(way[-1])
            ways.extend([*way, part] for part in parts.get(way[-1], ()))
    return None


def _check_values(ingredients: Sequence[Ingredient], recipe_yield: float) -> None:
    if not ingredients:
        raise ValueError("a recipe has ingredients")
    if not 0.0 < recipe_yield < math.inf:
        raise ValueError(f"a yield is positive and finite, not {recipe_yield}")
    for ingredient in ingredients:
        if not 0.0 < ingredient.mass_g < math.inf:
            raise ValueError(f"{ingredient.food.key}: a mass is positive and finite, not {ingredient.mass_g} g")
        if any(not 0.0 <= share <= 1.0 for share in ingredient.retention.values()):
            raise ValueError(f"{ingredient.food.key}: a retention is a share from 0 to 1")


def _check_ingredient(ingredient: Ingredient) -> None:
    food = ingredient.food
    if food.state != ingredient.state:
        known = f"is {food.state}" if food.state else "does not tell its state"
        raise InvalidInputError(
            f"{food.key!r} {known} in the food table, and the recipe takes it {ingredient.state}: choose the food in "
            "the state in which it was weighed. Raw and cooked are never interchangeable.",
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
            f"{food.key!r}: {name} takes no retention factor, it follows from the masses and from what else is lost.",
            code="retention_invalid",
            food=food.key,
            component=derived[0],
        )


def _other_numbers(ingredients: Sequence[Ingredient]) -> list[str]:
    return [number for ingredient in ingredients for number in ingredient.food.per_100_g]


def _amount(ingredient: Ingredient, number: str) -> float | None:
    """What is left of a component of the ingredient, in its unit; None if not known. Water: before the yield."""
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
    lost_kcal = math.fsum(grams * _KCAL_PER_G[macronutrient] for macronutrient, grams in lost_g.items())
    return max(0.0, amount - (kj_from_kcal(lost_kcal) if number == KILOJOULES else lost_kcal))


def _share_kept(ingredient: Ingredient, number: str) -> float:
    share = ingredient.retention.get(number)
    if share is not None:
        return share
    component = COMPONENT_BY_NUMBER.get(number)
    shares_fate_of_fat = component is not None and is_fatty_acid(component.name)
    return ingredient.retention.get(FAT, 1.0) if shares_fate_of_fat else 1.0


def _lost_g(ingredient: Ingredient) -> dict[str, float] | None:
    """Grams of each macronutrient that a retention says are lost; None if nobody knows how much of one there was."""
    lost: dict[str, float] = {}
    for number in _KCAL_PER_G.keys() & ingredient.retention.keys():
        if ingredient.retention[number] == 1.0:
            continue
        content = ingredient.food.per_100_g.get(number)
        if content is None:
            return None
        lost[number] = content_of_mass(content, ingredient.mass_g) * (1.0 - ingredient.retention[number])
    return lost
