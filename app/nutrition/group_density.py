"""Substitute densities for foods without their own: medians of the food group or of related groups, with a wide spread.

Uses the first of three levels that has enough foods: the group's volume portions whose measure states the kind
(chopped, mashed, cubic inch); the densities of the group's foods on any basis; the same over related groups, such as
all meats. Liquids are pooled separately: a syrup says nothing about a chocolate bar of the same group.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from app.nutrition.density import KIND_OF_FORM
from app.nutrition.foods import (
    DENSITY_KINDS,
    Density,
    DensityKind,
    Food,
    FoodForm,
    load_starter_table,
)
from app.nutrition.portion_density import MIN_GROUP_FOODS, group_median, group_medians

# Groups of the same tissue. Baked goods, snacks, sweets and dishes have no related group: a lasagna's density says
# nothing about a hamburger's.
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

# Bases that measure the food itself. A relative's density or another group's median would count that food twice.
OWN_BASES = frozenset({"study", "measured", "fao", "portion"})

_Pool = tuple[str, str]  # group; kind or "liquid"


def with_group_medians(
    foods: Sequence[Food], source: str, starter_foods: Mapping[str, Food] = MappingProxyType({})
) -> tuple[Food, ...]:
    """Return the foods with the medians of their group appended to their densities, the kind of their form first.

    source: readable name of the table. starter_foods: by NDB number; their densities count for the group too.
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
