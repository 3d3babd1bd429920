"""Substitute densities for foods without their own: medians with a wide spread.

Of the kind, for baked food and dishes (pizza, pie, fries), recognised by name: they differ widely
within one food group (bread has 0.2 g/ml, pie 0.9). The starter table's median of the kind takes
precedence over that of the group.

Of the group, or of related groups: the first of three levels that has enough foods. The group's
volume portions whose measure states the kind (chopped, mashed, cubic inch); the densities of the
group's foods on any basis; the same over related groups, such as all meats. Liquids are pooled
separately: a syrup says nothing about a chocolate bar of the same group.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from types import MappingProxyType

from app.nutrition.density import KIND_OF_FORM, resolve_density
from app.nutrition.foods import (
    DENSITY_KINDS,
    Density,
    DensityKind,
    Food,
    FoodForm,
    load_starter_table,
)
from app.nutrition.portion_density import MIN_GROUP_FOODS, group_median, group_medians

# Groups of the same tissue. Baked goods, snacks, sweets and dishes have no related group: a
# lasagna's density says nothing about a hamburger's.
RELATED_GROUPS: tuple[frozenset[str], ...] = (
    frozenset({
        "Beef Products",
        "Pork Products",
        "Poultry Products",
        "Lamb, Veal, and Game Products",
        "Sausages and Luncheon Meats",
        "Finfish and Shellfish Products",
    }),
)  # fmt: skip

# Bases that measure the food itself. A relative's density or another group's median would count
# that food twice.
OWN_BASES = frozenset({"study", "measured", "fao", "portion"})

_Pool = tuple[str, str]  # group; kind or "liquid"
# lower-case prefixes of group names
GROUPS = ("baked", "fast foods", "restaurant foods", "meals, entrees", "snacks")

# Names of each kind; the first match wins: a cheeseburger on a bun is not bread. Doughs, crumbs and
# the like are of no kind (_NONE).
MIN_FOODS = 3
# groups of the starter's fries, steaks, shrimps
_ALL = (*GROUPS, "beef", "pork", "poultry", "finfish", "vegetable")
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


def with_group_medians(
    foods: Sequence[Food], source: str, starter_foods: Mapping[str, Food] = MappingProxyType({})
) -> tuple[Food, ...]:
    """Return the foods with the medians of their group appended to their densities, the kind of their form first.

    source: readable name of the table. starter_foods: by NDB number; their densities count for the
    group too.
    """
    portion_medians = group_medians(((food.food_group, food.portions) for food in foods), source)
    medians: dict[_Pool, Density] = {
        (group, kind): median for (group, kind), median in portion_medians.items()
    }
    pools: dict[_Pool, list[float]] = {}
    for food in foods:
        same_food = starter_foods.get(food.source_ids.get("sr28_ndb", ""))
        densities = (*(same_food.densities if same_food else ()), *food.densities)
        for name, g_per_ml in _own_densities(food.form, densities).items():
            pools.setdefault((food.food_group, name), []).append(g_per_ml)
    related = {
        (group, name): [
            g_per_ml for other in sorted(groups) for g_per_ml in pools.get((other, name), [])
        ]
        for groups in RELATED_GROUPS
        for group in groups
        for name in (*DENSITY_KINDS, "liquid")
    }
    for wider, scope in ((pools, "the group {}"), (related, "groups like {}")):
        for (group, name), figures in wider.items():
            if (group, name) not in medians and len(figures) >= MIN_GROUP_FOODS:
                kind: DensityKind = "bulk" if name == "bulk" else "solid"
                text = f"{source}: median of {len(figures)} {_POOL_NOUNS[name]} of {scope.format(group)}"
                medians[group, name] = group_median(figures, kind, text)
    return tuple(
        replace(food, densities=(*food.densities, *(
            medians[food.food_group, name] for name in _pools_of(food.form) if (food.food_group, name) in medians
        )))
        for food in foods
    )  # fmt: skip


def starter_foods_by_ndb() -> Mapping[str, Food]:
    """Return the starter table's foods by NDB number; they have measured densities and refuse."""
    return {
        food.source_ids["sr28_ndb"]: food
        for food in load_starter_table().foods
        if "sr28_ndb" in food.source_ids
    }


def _pools_of(form: FoodForm) -> Sequence[str]:
    return (
        ("liquid",)
        if form == "liquid"
        else sorted(DENSITY_KINDS, key=lambda kind: kind != KIND_OF_FORM[form])
    )


_POOL_NOUNS: Mapping[str, str] = {"solid": "pieces", "bulk": "heaps", "liquid": "liquids"}


def _own_densities(form: FoodForm, densities: Iterable[Density]) -> dict[str, float]:
    """Return the best density per kind; a liquid's own density is of the kind "liquid"."""
    best: dict[str, float] = {}
    for density in densities:
        if density.basis in OWN_BASES:
            is_liquid = form == "liquid" and density.kind == "solid"
            best.setdefault("liquid" if is_liquid else density.kind, density.g_per_ml)
    return best


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
