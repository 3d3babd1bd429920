"""Density of a kind of baked food or dish (pizza, pie, fries), recognised by name: the starter table's median.

Baked foods and dishes of one food group differ widely: bread has 0.2 g/ml, pie 0.9. For a food without a density of its
own, the median of its kind takes precedence over that of its group.
"""

import re
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from app.nutrition.density import KIND_OF_FORM, resolve_density
from app.nutrition.foods import Density, DensityKind, FoodForm, load_starter_table
from app.nutrition.portion_density import group_median

GROUPS = (
    "baked",
    "fast foods",
    "restaurant foods",
    "meals, entrees",
    "snacks",
)  # lower-case prefixes of group names

# Names of each kind; the first match wins: a cheeseburger on a bun is not bread. Doughs, crumbs and the like are of no
# kind (_NONE).
MIN_FOODS = 3
_ALL = (
    *GROUPS,
    "beef",
    "pork",
    "poultry",
    "finfish",
    "vegetable",
)  # groups of the starter's fries, steaks, shrimps
_NONE = re.compile(
    r"\b(?:mix|dough|(?<!soft )bread crumbs|croutons|pie crust|batter|pie fillings?|stuffing|salads?|ice cream|"
    r"rice cakes?|crab|chips|crisps|puffs|egg rolls?|bread, (?:banana|pumpkin|boston|irish|nut))\b",
    re.IGNORECASE,
)
_NAMES: Mapping[DensityKind, Mapping[str, str]] = {
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
        density_kind: {
            kind: re.compile(rf"\b(?:{names})\b", re.IGNORECASE) for kind, names in kinds.items()
        }
        for density_kind, kinds in _NAMES.items()
    }
)


def kind_density(name: str, group: str, form: FoodForm) -> tuple[Density, ...]:
    """Return the density of the kind that this name and form have; empty if there is none or too few foods."""
    if form == "liquid" or not group.lower().startswith(GROUPS):
        return ()
    median = _medians().get(_kind(name, KIND_OF_FORM[form]) or "")
    return () if median is None else (median,)


def _kind(name: str, density_kind: DensityKind) -> str | None:
    if _NONE.search(name):
        return None
    return next((kind for kind, names in _KINDS[density_kind].items() if names.search(name)), None)


@cache
def _medians() -> Mapping[str, Density]:
    densities_of_kind: dict[tuple[str, DensityKind], list[float]] = {}
    for food in load_starter_table().foods:
        choice, density_kind = resolve_density(food), KIND_OF_FORM[food.form]
        kind = _kind(f"{food.name}, {food.source_ids.get('sr28_name', '')}", density_kind)
        if (
            kind is not None
            and food.form != "liquid"
            and food.food_group.lower().startswith(
                GROUPS if density_kind == "solid" and kind != "meat" else _ALL
            )
            and choice is not None
            and choice.chosen.kind == density_kind
            and choice.chosen.basis != "group"
        ):
            densities_of_kind.setdefault((kind, density_kind), []).append(choice.chosen.g_per_ml)
    return MappingProxyType(
        {
            kind: group_median(
                densities,
                density_kind,
                f"starter table: median of {len(densities)} foods of the kind {kind}",
            )
            for (kind, density_kind), densities in densities_of_kind.items()
            if len(densities) >= MIN_FOODS
        }
    )
