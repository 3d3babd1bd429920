"""Density of a kind of baked food or dish that a name tells (pizza, pie, bread): the median of the starter's of it.

Baked foods and dishes of one food group are nothing alike: bread has 0.2 g/ml, pie 0.9. Where a food has no density of
its own, its kind's median stands before its group's.
"""

import re
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from app.nutrition.density import KIND_OF_FORM, resolve_density
from app.nutrition.foods import Density, FoodForm, load_starter_table
from app.nutrition.portion_density import MIN_GROUP_FOODS, group_median

GROUPS = ("baked", "fast foods", "restaurant foods", "meals, entrees", "snacks")  # by how their names open, lower case

# What a food of this kind is called, the first that fits: a cheeseburger on a bun is no bread. What is not yet, or no
# longer, a piece of the kind is of none.
_NONE = re.compile(
    r"\b(?:mix|dough|(?<!soft )bread crumbs|croutons|pie crust|batter|pie fillings?|stuffing|salads?|ice cream|"
    r"rice cakes?|crab|chips|crisps|puffs|egg rolls?|bread, (?:banana|pumpkin|boston|irish|nut))\b",
    re.IGNORECASE,
)
_KINDS: Mapping[str, re.Pattern[str]] = MappingProxyType(
    {
        kind: re.compile(rf"\b(?:{words})\b", re.IGNORECASE)
        for kind, words in {
            "pizza": r"pizzas?",
            "filled tortilla": r"burritos?|wraps?|tacos?(?! shells?)|quesadillas?|enchiladas?",
            "hamburger": r"(?<!rolls, )hamburgers?(?! bun| or hot)|cheeseburgers?",
            "cookie": r"cookies?|brownies?|shortbread",
            "cracker": r"crackers?|crispbreads?|matzo|melba|taco shells?",
            "sandwich": r"submarine|sub|sandwich(?:es)?",
            "pie": r"pies?|strudels?|cobblers?|cheesecakes?",
            "doughnut or sweet pastry": r"doughnuts?|danish|croissants?|sweet rolls?|cinnamon buns?",
            "cake": r"cakes?|cupcakes?|gingerbread",
            "muffin or biscuit": r"muffins?|scones?|biscuits?|cornbread",
            "flat bread": r"tortillas?|chapati|roti|naan|paratha|pita",
            "bread": r"breads?|rolls?|buns?",
        }.items()
    }
)


def kind_density(name: str, group: str, form: FoodForm) -> tuple[Density, ...]:
    """The density of the kind that this name tells, for a solid piece; empty where it tells none, or few are known."""
    if KIND_OF_FORM[form] != "solid" or form == "liquid" or not group.lower().startswith(GROUPS):
        return ()
    median = _medians().get(_kind(name) or "")
    return () if median is None else (median,)


def _kind(name: str) -> str | None:
    if _NONE.search(name):
        return None
    return next((kind for kind, words in _KINDS.items() if words.search(name)), None)


@cache
def _medians() -> Mapping[str, Density]:
    found: dict[str, list[float]] = {}
    for food in load_starter_table().foods:
        choice = resolve_density(food)
        kind = _kind(f"{food.name}, {food.source_ids.get('sr28_name', '')}")
        if (
            kind is not None
            and food.food_group.lower().startswith(GROUPS)
            and food.form != "liquid"
            and KIND_OF_FORM[food.form] == "solid"
            and choice is not None
            and choice.chosen.kind == "solid"
            and choice.chosen.basis != "group"
        ):
            found.setdefault(kind, []).append(choice.chosen.g_per_ml)
    return MappingProxyType(
        {
            kind: group_median(
                densities, "solid", f"starter table: median of {len(densities)} foods of the kind {kind}"
            )
            for kind, densities in found.items()
            if len(densities) >= MIN_GROUP_FOODS
        }
    )
