"""Regions beside vessels: a mug's handle is no food, what stands beside a mug is."""

import cv2
import numpy as np
import pytest

from app.vision.geometry.masks import distance_px
from app.vision.scene.liquids import HANDLE_REACH_PX, _is_handle

SHAPE = (400, 600)


def drawn(*shapes):
    picture = np.zeros(SHAPE, np.uint8)
    for kind, *values in shapes:
        if kind == "box":
            cv2.rectangle(picture, *values, 1, -1)
        else:
            cv2.ellipse(picture, *values, 0, 0, 360, 1, -1)
    return picture > 0


@pytest.mark.parametrize(
    ("region", "is_handle"),
    [
        (drawn(("box", (335, 150), (375, 250))), True),  # a handle with the table that is seen through it
        (drawn(("box", (340, 105), (355, 295))), True),  # a strip of cloth along the wall
        (drawn(("ellipse", (375, 260), (38, 34))), False),  # a strawberry that touches the mug
        (drawn(("ellipse", (420, 260), (38, 34))), False),  # and one beside it
        (drawn(("box", (340, 120), (500, 300))), False),  # a loaf against it
    ],
)
def test_handle_is_told_from_food_beside_the_vessel(region, is_handle):
    mug = drawn(("box", (200, 100), (330, 300)))
    assert _is_handle(region, mug, distance_px(mug) <= HANDLE_REACH_PX) == is_handle
