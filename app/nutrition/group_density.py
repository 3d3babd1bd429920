"""Densities that stand in for a food's own: the median of its food group, or of kindred groups, with a wide spread.

Three rungs, the first that has enough foods: the group's volume portions whose words say the kind (chopped, mashed,
cubic inch); what is known of the group's foods by any means; the same over kindred groups, such as all meats. Liquids
are a matter of their own: a syrup says nothing about a chocolate bar of the same group.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from app.nutrition.density import KIND_OF_FORM
from app.nutrition.foods import DENSITY_KINDS, Density, DensityKind, Food, FoodForm, load_starter_table
from app.nutrition.portion_density import MIN_GROUP_FOODS, group_median, group_medians
from app.nutrition.portions import Portion

# Groups that hold the same tissue. Baked goods, snacks, sweets and dishes are like nothing else: a lasagna's density
# says nothing about a hamburger's.
KINDRED_GROUPS: tuple[frozenset[str], ...] = (
    frozenset({
        "Beef Products",
        "Pork Products",
        "Poultry Products",
        "Lamb, Veal, and Game Products",
        "Sausages and Luncheon Meats",
        "Finfish and Shellfish Products",
    }),
)  # fmt: skip

# What says how dense the food itself is. A relative's figure or another group's median would count somebody else twice.
OWN_BASES = frozenset({"study", "measured", "fao", "portion"})

_Pool = tuple[str, str]  # group, and the kind or "liquid"


@dataclass(frozen=True, slots=True)
class GroupMember:
    """What one food adds to its group's medians. densities: all that is known of the food itself, best first."""

    group: str
    form: FoodForm
    portions: Sequence[Portion]
    densities: Sequence[Density]


class GroupDensities:
    """The medians of all groups. source: whose foods they are, for a person."""

    def __init__(self, members: Iterable[GroupMember], source: str) -> None:
        members = list(members)
        by_words = group_medians(((member.group, member.portions) for member in members), source)
        self._medians: dict[_Pool, Density] = {(group, kind): median for (group, kind), median in by_words.items()}
        pools: dict[_Pool, list[float]] = {}
        for member in members:
            for name, g_per_ml in _known(member).items():
                pools.setdefault((member.group, name), []).append(g_per_ml)
        kindred = {
            (group, name): [g_per_ml for one in sorted(groups) for g_per_ml in pools.get((one, name), [])]
            for groups in KINDRED_GROUPS
            for group in groups
            for name in (*DENSITY_KINDS, "liquid")
        }
        for wider, of in ((pools, "the group {}"), (kindred, "groups like {}")):
            for (group, name), found in wider.items():
                if (group, name) not in self._medians and len(found) >= MIN_GROUP_FOODS:
                    kind: DensityKind = "bulk" if name == "bulk" else "solid"
                    text = f"{source}: median of {len(found)} {_WHAT[name]} of {of.format(group)}"
                    self._medians[group, name] = group_median(found, kind, text)

    def of(self, group: str, form: FoodForm) -> tuple[Density, ...]:
        """What stands in for a food of this group that lies in this form, the kind that it takes first."""
        if form == "liquid":
            names: Sequence[str] = ("liquid",)
        else:
            names = sorted(DENSITY_KINDS, key=lambda kind: kind != KIND_OF_FORM[form])
        return tuple(self._medians[group, name] for name in names if (group, name) in self._medians)


def packaged_by_ndb() -> Mapping[str, Food]:
    """NDB number -> that food of the packaged table, which knows measured densities and what of a food is refuse."""
    return {food.source_ids["sr28_ndb"]: food for food in load_starter_table().foods if "sr28_ndb" in food.source_ids}


_WHAT: Mapping[str, str] = {"solid": "pieces", "bulk": "heaps", "liquid": "liquids"}


def _known(member: GroupMember) -> dict[str, float]:
    """The best density of each kind; of a liquid, of the liquid."""
    known: dict[str, float] = {}
    for density in member.densities:
        if density.basis in OWN_BASES:
            is_liquid = member.form == "liquid" and density.kind == "solid"
            known.setdefault("liquid" if is_liquid else density.kind, density.g_per_ml)
    return known
