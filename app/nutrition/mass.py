"""Millilitres to grams: volume x density -> the mass as seen, less its refuse -> the edible mass, with their doubt."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from app.nutrition.density import KIND_OF_FORM
from app.nutrition.doubt import Doubt, Estimate, Term, combine, estimate
from app.nutrition.foods import Density, Food, FoodForm

BEFORE, AFTER = "before", "after"  # the two pairs of photographs of one meal


@dataclass(frozen=True, slots=True)
class Mass:
    """One item's mass: as it was photographed, and what of it is eaten; grams with 90 % intervals, doubt by parts."""

    as_seen_g: Estimate
    edible_g: Estimate
    edible_share: float
    doubt: Doubt


def estimate_mass(volume_ml: float, volume_doubt: Doubt, density: Density, *, edible_share: float = 1.0) -> Mass:
    """Mass of an item: volume (ml) x density (g/ml), and its edible share (0 to 1, from `edible_share`).

    The density's spread is added to the doubt's part "density". A density of edible mass (Density.weighs) gives the
    edible grams, from which the mass as seen follows. The refuse figures have no published spread; none is made up.
    Raises ValueError if volume or share is not positive and finite, or the share passes 1.
    """
    if not 0.0 < volume_ml < math.inf:
        raise ValueError(f"a volume is positive and finite, not {volume_ml} ml")
    if not 0.0 < edible_share <= 1.0:
        raise ValueError(f"an edible share is above 0 and at most 1, not {edible_share}")
    doubt = Doubt(volume_doubt.pair, math.hypot(volume_doubt.density, density.relative_sd), volume_doubt.item)
    return _mass(volume_ml * density.g_per_ml, doubt, edible_share, is_edible=density.weighs == "edible")


def weighed_mass(mass_g: float, relative_sd: float, *, is_edible: bool, edible_share: float = 1.0) -> Mass:
    """Mass of an item whose grams a person tells. is_edible: without its refuse; else as seen.

    relative_sd: how far off the person may be. Raises ValueError if the mass is not positive and finite.
    """
    if not 0.0 < mass_g < math.inf:
        raise ValueError(f"a mass is positive and finite, not {mass_g} g")
    return _mass(mass_g, Doubt(item=relative_sd), edible_share, is_edible=is_edible)


def consumed_mass(served: Mass, left: Sequence[Mass], *, food_key: str, share: float = 1.0) -> Estimate:
    """Edible grams eaten: served less left, times the eater's share (above 0, at most 1) of the dish.

    Signed: where the doubt is greater than what was eaten it may come out below 0, and stays so, since means over many
    meals would be biased by clipping. The two pairs of photographs have their own doubt, the food's density is shared.
    """
    if not 0.0 < share <= 1.0:
        raise ValueError(f"a share is above 0 and at most 1, not {share}")
    terms = [Term(served.edible_g.value, served.doubt, BEFORE, food_key)]
    terms += [Term(one.edible_g.value, one.doubt, AFTER, food_key, sign=-1) for one in left]
    return combine(terms).scaled(share) if left else served.edible_g.scaled(share)


def edible_share(food: Food, *, form: FoodForm | None = None, without: Collection[str] | None = None) -> float:
    """What share of an item's mass as seen is eaten, by the food's refuse.

    form: how the item lies (None: as usual). A food of solid pieces that is met as a heap or in a vessel was peeled
    and cut: nothing is refused. without: the parts that are off already (None: those that are not usually served): a
    pineapple without its crown is (100 - 49) / (100 - 16) edible.
    Raises ValueError if `without` names a part that the food does not have.
    """
    if form is not None and KIND_OF_FORM[form] == "bulk" and KIND_OF_FORM[food.form] == "solid":
        return 1.0
    if without is None:
        without = {part.part for part in food.refuse if not part.is_served}
    unknown = set(without) - {part.part for part in food.refuse}
    if unknown:
        raise ValueError(f"{food.key} has no part {', '.join(sorted(unknown))}")
    refused = math.fsum(part.percent for part in food.refuse)
    absent = math.fsum(part.percent for part in food.refuse if part.part in without)
    return (100.0 - refused) / (100.0 - absent)


def _mass(mass_g: float, doubt: Doubt, edible_share: float, *, is_edible: bool) -> Mass:
    weighed_g = estimate(mass_g, doubt)
    if is_edible:
        return Mass(weighed_g.scaled(1.0 / edible_share), weighed_g, edible_share, doubt)
    return Mass(weighed_g, weighed_g.scaled(edible_share), edible_share, doubt)
