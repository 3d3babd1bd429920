"""Millilitres to grams: volume x density -> mass as seen, minus refuse -> edible mass, each with its doubt."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from app.nutrition.density import KIND_OF_FORM
from app.nutrition.doubt import Doubt, Estimate, Term, combine, estimate
from app.nutrition.foods import Density, Food, FoodForm

BEFORE, AFTER = "before", "after"  # the two pairs of photographs of one meal


@dataclass(frozen=True, slots=True)
class Mass:
    """One item's mass as photographed and its edible mass: grams with 90 % intervals, and the doubt by part."""

    as_seen_g: Estimate
    edible_g: Estimate
    edible_share: float
    doubt: Doubt


def estimate_mass(
    volume_ml: float, volume_doubt: Doubt, density: Density, *, edible_share: float = 1.0
) -> Mass:
    """Return the mass of an item: volume (ml) x density (g/ml), and its edible share (0 to 1, from `edible_share`).

    The density's spread is added to the doubt's part "density". A density of edible mass
    (Density.weighs) gives the edible grams, from which the mass as seen is computed. Refuse has no
    published spread, and none is assumed. Raises ValueError if volume or share is not positive and
    finite, or the share exceeds 1.
    """
    if not 0.0 < volume_ml < math.inf:
        raise ValueError(f"a volume is positive and finite, not {volume_ml} ml")
    if not 0.0 < edible_share <= 1.0:
        raise ValueError(f"an edible share is above 0 and at most 1, not {edible_share}")
    doubt = Doubt(
        volume_doubt.pair, math.hypot(volume_doubt.density, density.relative_sd), volume_doubt.item
    )
    return _mass(
        volume_ml * density.g_per_ml, doubt, edible_share, is_edible=density.weighs == "edible"
    )


def weighed_mass(
    mass_g: float, relative_sd: float, *, is_edible: bool, edible_share: float = 1.0
) -> Mass:
    """Return the mass of an item whose grams a person states.

    is_edible: without refuse; otherwise as seen.

    relative_sd: error of the person's figure. Raises ValueError if the mass is not positive and
    finite.
    """
    if not 0.0 < mass_g < math.inf:
        raise ValueError(f"a mass is positive and finite, not {mass_g} g")
    return _mass(mass_g, Doubt(item=relative_sd), edible_share, is_edible=is_edible)


def consumed_mass(
    served: Mass, left: Sequence[Mass], *, food_key: str, share: float = 1.0
) -> Estimate:
    """Return the edible grams eaten: served minus left, times the eater's share (above 0, at most 1) of the dish.

    Signed: if the doubt exceeds the amount eaten it may be below 0 and is not clipped, which would
    bias means over many meals. The two pairs of photographs have independent doubt; the doubt of
    the food's density is shared.
    """
    if not 0.0 < share <= 1.0:
        raise ValueError(f"a share is above 0 and at most 1, not {share}")
    terms = [Term(served.edible_g.value, served.doubt, BEFORE, food_key)]
    terms += [Term(piece.edible_g.value, piece.doubt, AFTER, food_key, sign=-1) for piece in left]
    return combine(terms).scaled(share) if left else served.edible_g.scaled(share)


def edible_share(
    food: Food, *, form: FoodForm | None = None, without: Collection[str] | None = None
) -> float:
    """Return the edible share of an item's mass as seen, from the food's refuse.

    form: of the item (None: the usual one). A food of solid pieces in a heap or a vessel was peeled
    and cut, so it has no refuse. without: parts already removed (None: those not usually served): a
    pineapple without its crown is (100 - 49) / (100 - 16) edible. Raises ValueError if `without`
    names a part that the food does not have.
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
