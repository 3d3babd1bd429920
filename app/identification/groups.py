"""Groups of foods: what a region surely is where no single food is likely enough.

A group takes the place of its members as one class. Its score is theirs together, since the
regression on memberships is linear; its prior is theirs together. Members that look alike share
what a region's neighbours say, so that an orange or a lemon is surely citrus fruit.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from app.identification.kernel_classifier import Calibration
from app.identification.metric import Vectors

# Times the foods' temperature: sums of scores say more than they know. With it four in a hundred
# photographs of shops are assigned to a group, all rightly, and of foods that the index does not
# know one in a hundred to a wrong one (decision 0068).
TEMPERATURE = 1.7


def group_probabilities(
    scores: Vectors,
    log_odds: Vectors,
    groups: Mapping[str, NDArray[np.bool_]],
    calibration: Calibration,
    none_prior: float,
) -> dict[str, float]:
    """Return the probability of each group, each by itself in place of its members.

    scores: (classes,) of one region. log_odds: (classes,) what sizes and habits say. groups:
    (classes,) whether a class is a member.
    """
    temperature = TEMPERATURE * calibration.temperature
    joint = scores / temperature + log_odds + np.log1p(-none_prior)
    none = calibration.none_score / temperature + np.log(none_prior)
    top = joint.max()
    weights, of_none = np.exp(joint - top), np.exp(none - top)
    shares = {}
    for key, own in groups.items():
        log_group = (
            scores[own].sum() / temperature
            + np.logaddexp.reduce(log_odds[own])
            + np.log1p(-none_prior)
        )
        group = np.exp(log_group - top)
        shares[key] = float(group / (weights.sum() - weights[own].sum() + group + of_none))
    return shares
