"""How urgently an item needs review, 0 to 1: the order of the review queue. Pure.

Three causes of doubt count as independent: that the food is another (its improbability by the
index; 0 once a person has named it), that the amount is another (the width of the 90 % interval of
what was eaten, relative to what was served), and each flag. 1 means unknown, which ranks before
everything that is merely uncertain. Grams do not matter: a leaf and a steak of equal uncertainty
rank equally.
"""

import math
from collections.abc import Collection

from app.nutrition.doubt import Estimate

FLAG_DOUBT = 0.3  # of each flag by itself
UNKNOWN = 1.0
MOST = math.nextafter(1.0, 0.0)  # of what is known, however badly


def review_doubt(
    probability: float, eaten: Estimate | None, served_g: float, flags: Collection[str]
) -> float:
    """Return the doubt about an item that is not rejected.

    probability: that it is this food, 0 to 1
    eaten: edible grams with their interval; None: unknown
    served_g: the participant's share of the edible grams served, > 0. The doubt never falls with a
        wider interval, a lower probability or a further flag.
    """
    if eaten is None:
        return UNKNOWN
    half_width = (eaten.high - eaten.low) / (2.0 * served_g)
    surety = probability * math.exp(-half_width) * (1.0 - FLAG_DOUBT) ** len(set(flags))
    return min(1.0 - surety, MOST)
