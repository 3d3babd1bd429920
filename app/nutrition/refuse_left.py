"""Classify leftovers as refuse (peel, core, bone) or food left, by how much refuse the food as served can have had.

A piece is weighed with the density of the whole food. Peel is lighter and lies hollow, so its mass
is overestimated, seldom underestimated: a piece classified as refuse is rarely food, but a peel may
be classified as food left. Both are proposals and are flagged.
"""

import math
from collections.abc import Sequence
from typing import Literal

from app.nutrition.doubt import Z_90
from app.nutrition.mass import Mass

# classified as refuse by its amount: it may be a small piece of food
REFUSE_ASSUMED = "refuse_assumed"
# classified as food by its amount: it may be, or contain, refuse
REFUSE_POSSIBLE = "refuse_possible"

# largest factor by which a hollow peel's mass is overestimated: an assumption without a source
HOLLOW = 2.0

LeftoverClass = Literal["food_left", "refuse"]


def classify_left(
    served: Mass | None, pieces: Sequence[Mass | None], reviewed: Sequence[LeftoverClass | None]
) -> list[tuple[LeftoverClass, str | None]]:
    """Return (class, flag or None) of each leftover piece of one item.

    reviewed: a person's class of each, or None.

    From the lightest piece on, pieces are refuse as long as all refuse together does not exceed the
    served food's, given the 90 % doubt of both. A food that is eaten whole leaves no refuse.
    """
    classes: list[tuple[LeftoverClass, str | None]] = [
        (label or "food_left", None) for label in reviewed
    ]
    if served is None or served.edible_share >= 1.0:
        return classes
    refuse_g = served.as_seen_g.value * (1.0 - served.edible_share)
    weighed = [(piece, place) for place, piece in enumerate(pieces) if piece is not None]
    refuse_so_far_g = math.fsum(
        piece.as_seen_g.value for piece, place in weighed if reviewed[place] == "refuse"
    )
    unreviewed = [(piece, place) for piece, place in weighed if reviewed[place] is None]
    for piece, place in sorted(unreviewed, key=lambda entry: entry[0].as_seen_g.value):
        sd = math.sqrt(_own_log_variance(served) + _own_log_variance(piece))
        limit_g = refuse_g * math.exp(Z_90 * sd) - refuse_so_far_g
        if piece.as_seen_g.value <= limit_g:
            refuse_so_far_g += piece.as_seen_g.value
            classes[place] = ("refuse", REFUSE_ASSUMED)
        elif piece.as_seen_g.value <= HOLLOW * limit_g:
            classes[place] = ("food_left", REFUSE_POSSIBLE)
    return classes


def _own_log_variance(mass: Mass) -> float:
    """Return the log variance of the volume alone: served and left have the same density, whose error cancels."""
    return math.log1p(mass.doubt.pair**2) + math.log1p(mass.doubt.item**2)
