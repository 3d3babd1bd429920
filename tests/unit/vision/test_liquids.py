"""Regions beside vessels: a mug's handle is no food, what stands beside a mug is."""

import cv2
import numpy as np
import pytest

from app.vision.filled_vessel import FilledVessel, LiquidVolume
from app.vision.liquid_level import Level
from app.vision.liquids import _is_handle
from app.vision.mesh import ClosedShape
from app.vision.rims import SAMPLES, Circle
from app.vision.segmentation import Region

SHAPE = (400, 600)


def drawn(*shapes):
    picture = np.zeros(SHAPE, np.uint8)
    for kind, *values in shapes:
        if kind == "box":
            cv2.rectangle(picture, *values, 1, -1)
        else:
            cv2.ellipse(picture, *values, 0, 0, 360, 1, -1)
    return picture > 0


def mug():
    silhouette = drawn(("box", (200, 100), (330, 300)))
    rim = Circle(np.zeros(2), 42.0, 85.0, 1.0, 0.3, np.ones((2, SAMPLES), np.bool_))
    shape = ClosedShape(np.zeros((3, 3)), np.zeros((1, 3), np.int64))
    liquid = LiquidVolume(200.0, 10.0, 5.0, (), shape)
    return FilledVessel(silhouette, silhouette, rim, Level(65.0, 39.0, (0.5, 0.5), 30.0), 0.0, liquid)


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
    assert _is_handle(Region(region), mug()) == is_handle
