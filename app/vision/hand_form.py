"""Forms that a person gives a food by hand, after Woo et al. (2010): a few sizes on the table, and their volume.

static/reshape-form.js draws the same forms; tests/e2e/test_reshape_logic.py compares the two.
"""

import math
from typing import Literal

from app.core.units import ml_from_mm3

HandSection = Literal["prism", "ellipsoid", "slab"]
BOX_SHARE = {
    "slab": 1.0,
    "prism": math.pi / 4,
    "ellipsoid": math.pi / 6,
}  # of the box around the upright form


def hand_form_ml(
    section: HandSection, length_mm: float, width_mm: float, height_mm: float
) -> float:
    """Return the volume of a form, ml.

    slab: upright sides over a rectangle; prism: upright sides over an ellipse. A form that leans has each of its levels
    moved sideways, which by Cavalieri's principle leaves the volume as it is.
    """
    return ml_from_mm3(BOX_SHARE[section] * length_mm * width_mm * height_mm)
