"""Density of a kind of baked food or dish that a name tells (pizza, pie, fries): the median of the starter's of it.

Baked foods and dishes of one food group are nothing alike: bread has 0.2 g/ml, pie 0.9. Where a food has no density of
its own, its kind's median stands before its group's.
"""

import re
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from app.nutrition.density import KIND_OF_FORM, resolve_density
from app.nutrition.foods import Density, DensityKind, FoodForm, load_starter_table
from app.nutrition.portion_density import group_median

GROUPS = ("baked", "fast foods", "restaurant foods", "meals, entrees", "snacks")  # by how their names open, lower case

# What a food of this kind is called, the first that fits: a cheeseburger on a bun is no bread. What is not yet, or no
# longer, a piece of the kind is of none.
MIN_FOODS = 3
_ALL = (*GROUPS, "beef", "pork", "poultry", "finfish", "vegetable")  # groups of the starter's fries, steaks, shrimps
_NONE = re.compile(
    r"\b(?:mix|dough|(?<!soft )bread crumbs|croutons|pie crust|batter|pie fillings?|stuffing|salads?|ice cream|"
    r"rice cakes?|crab|chips|crisps|puffs|egg rolls?|bread, (?:banana|pumpkin|boston|irish|nut))\b",
    re.IGNORECASE,
)
_WORDS: Mapping[DensityKind, Mapping[str, str]] = {
    "solid": {
        "pizza": r"pizzas?",
        "filled tortilla": r"burritos?|wraps?|tacos?(?! shells?)|quesadillas?|enchiladas?",
        "hamburger": r"(?<!rolls, )hamburgers?(?! bun| or hot)|cheeseburgers?|big mac|whopper|quarter pounder",
        "cookie": r"cookies?|brownies?|shortbread",
        "cracker": r"crackers?(?! barrel)|crispbreads?|matzo|melba|taco shells?",
        "sandwich": r"submarine|sub|sandwich(?:es)?|filet-o-fish|mcmuffin|mcgriddles|croissan'wich",
        "pie": r"pies?|strudels?|cobblers?|cheesecakes?",
        "doughnut or sweet pastry": r"doughnuts?|danish|croissants?|sweet rolls?|cinnamon buns?",
        "cake": r"cakes?|cupcakes?|gingerbread",
        "pancake": r"pancakes?|hotcakes|waffles?|french toast",
        "muffin or biscuit": r"muffins?|scones?|biscuits?|cornbread",
        "meat": r"steaks?|fillets?|fried chicken",
        "flat bread": r"tortillas?|chapati|roti|naan|paratha|pita",
        "bread": r"breads?|rolls?|buns?",
        "bar": r"bars?",
    },
    "bulk": {
        "fried potatoes": r"french fries|french fried|french-fried|onion rings",
        "breaded pieces": r"nuggets?|mcnuggets|tenders|strips|popcorn chicken|boneless pieces|shrimp",
    },
}
_KINDS: Mapping[DensityKind, Mapping[str, re.Pattern[str]]] = MappingProxyType(
    {
        density_kind: {kind: re.compile(rf"\b(?:{words})\b", re.IGNORECASE) for kind, words in kinds.items()}
        for density_kind, kinds in _WORDS.items()
    }
)


def kind_density(name: str, group: str, form: FoodForm) -> tuple[Density, ...]:
    """The density of the kind that this name tells, in this form; empty where it tells none, or few are known."""
    if form == "liquid" or not group.lower().startswith(GROUPS):
        return ()
    median = _medians().get(_kind(name, KIND_OF_FORM[form]) or "")
    return () if median is None else (median,)


def _kind(name: str, density_kind: DensityKind) -> str | None:
    if _NONE.search(name):
        return None
    return next((kind for kind, words in _KINDS[density_kind].items() if words.search(name)), None)


@cache
def _medians() -> Mapping[str, Density]:
    found: dict[tuple[str, DensityKind], list[float]] = {}
    for food in load_starter_table().foods:
        choice, density_kind = resolve_density(food), KIND_OF_FORM[food.form]
        kind = _kind(f"{food.name}, {food.source_ids.get('sr28_name', '')}", density_kind)
        if (
            kind is not None
            and food.form != "liquid"
            and food.food_group.lower().startswith(GROUPS if density_kind == "solid" and kind != "meat" else _ALL)
            and choice is not None
            and choice.chosen.kind == density_kind
            and choice.chosen.basis != "group"
        ):
            found.setdefault((kind, density_kind), []).append(choice.chosen.g_per_ml)
    return MappingProxyType(
        {
            kind: group_median(its, density_kind, f"starter table: median of {len(its)} foods of the kind {kind}")
            for (kind, density_kind), its in found.items()
            if len(its) >= MIN_FOODS
        }
    )
