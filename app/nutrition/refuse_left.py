"""Whether what was left of a food is its refuse (peel, core, bone): by how much refuse the food as served can have had.

A piece is weighed as if it were the whole food. Peel is lighter than that and lies hollow, so its mass comes out too
great, seldom too small: what passes for refuse hardly is more than refuse, but a peel may be taken for food left. Both
are proposals, and flagged.
"""

import math
from collections.abc import Sequence
from typing import Literal

from app.nutrition.doubt import Z_90
from app.nutrition.mass import Mass

REFUSE_ASSUMED = "refuse_assumed"  # taken for refuse by its amount: it may be a small piece of food
REFUSE_POSSIBLE = "refuse_possible"  # taken for food by its amount: it may be, or hold, refuse

HOLLOW = 2.0  # of what a peel weighs when it is measured as if it were whole: at worst, an assumption without a source

LeftoverClass = Literal["food_left", "refuse"]


def classify_left(
    served: Mass | None, pieces: Sequence[Mass | None], told: Sequence[LeftoverClass | None]
) -> list[tuple[LeftoverClass, str | None]]:
    """(class, flag or None) of each piece left of one item. served: as it was served; told: what a person said.

    From the lightest piece on they are refuse as long as all refuse together is no more than the served food's, given
    the 90 % doubt of both. A food that is eaten whole leaves no refuse.
    """
    out: list[tuple[LeftoverClass, str | None]] = [(each or "food_left", None) for each in told]
    if served is None or served.edible_share >= 1.0:
        return out
    refuse_g = served.as_seen_g.value * (1.0 - served.edible_share)
    weighed = [(piece, place) for place, piece in enumerate(pieces) if piece is not None]
    taken_g = math.fsum(piece.as_seen_g.value for piece, place in weighed if told[place] == "refuse")
    open_ones = [(piece, place) for piece, place in weighed if told[place] is None]
    for piece, place in sorted(open_ones, key=lambda each: each[0].as_seen_g.value):
        sd = math.sqrt(_own_log_variance(served) + _own_log_variance(piece))
        most_g = refuse_g * math.exp(Z_90 * sd) - taken_g
        if piece.as_seen_g.value <= most_g:
            taken_g += piece.as_seen_g.value
            out[place] = ("refuse", REFUSE_ASSUMED)
        elif piece.as_seen_g.value <= HOLLOW * most_g:
            out[place] = ("food_left", REFUSE_POSSIBLE)
    return out


def _own_log_variance(mass: Mass) -> float:
    """Of the volume alone: served and left are weighed by the same density, whose error cancels."""
    return math.log1p(mass.doubt.pair**2) + math.log1p(mass.doubt.item**2)
