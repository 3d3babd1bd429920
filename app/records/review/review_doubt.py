"""How much an item needs a reviewer's look, 0 to 1: the order of the review queue. Pure.

What speaks against a record is taken as independent: that it is another food (its improbability by the server's own
reckoning, nothing once a person has named it), that the amount is another (the width of the 90 % interval of what was
eaten, against what was served), and each flag. 1 stands for what nobody knows, so that it comes before all that is
merely unsure. It measures doubt and not weight: a leaf and a steak that are equally unsure stand side by side.
"""

import math
from collections.abc import Collection

from app.nutrition.doubt import Estimate

FLAG_DOUBT = 0.3  # of each flag by itself
UNKNOWN = 1.0
MOST = math.nextafter(1.0, 0.0)  # of what is known, however badly


def review_doubt(probability: float, eaten: Estimate | None, served_g: float, flags: Collection[str]) -> float:
    """The doubt about an item that counts.

    probability: that it is this food, 0 to 1. eaten: edible grams with their interval; None: not known. served_g: the
    participant's share of what was served, edible grams, > 0. It never falls with a wider interval, a lower probability
    or a further flag.
    """
    if eaten is None:
        return UNKNOWN
    half_width = (eaten.high - eaten.low) / (2.0 * served_g)
    surety = probability * math.exp(-half_width) * (1.0 - FLAG_DOUBT) ** len(set(flags))
    return min(1.0 - surety, MOST)
