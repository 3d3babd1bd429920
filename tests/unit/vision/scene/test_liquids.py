"""Regions beside vessels: a mug's handle is no food, what stands beside a mug is."""

import cv2
import numpy as np
import pytest

from app.vision.scene.filled_vessel import StandingVessel, Vessels
from app.vision.scene.liquids import HANDLE_MIN_POINTS, _is_part_of_vessel
from app.vision.scene.rims import Circle
from app.vision.scene.segmentation import Region
from app.vision.scene.support import Support

SHAPE = (400, 600)


def drawn(*shapes):
    picture = np.zeros(SHAPE, np.uint8)
    for kind, *values in shapes:
        if kind == "box":
            cv2.rectangle(picture, *values, 1, -1)
        else:
            cv2.ellipse(picture, *values, 0, 0, 360, 1, -1)
    return picture > 0


RIM_MM, TABLE_MM = 90.0, 1.5
MUG = StandingVessel(
    np.zeros((1, 1), np.bool_), Circle(np.array([30.0, -20.0]), 42.0, RIM_MM + TABLE_MM, 0.9), TABLE_MM
)
rng = np.random.default_rng(5)


def turned(points, degrees):
    """Points (n, 3) of a mug about the z axis through the origin -> about MUG's axis, turned, with 1 mm of noise."""
    turn = np.radians(degrees)
    matrix = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return points @ matrix.T + [*MUG.rim.centre_mm, TABLE_MM] + rng.normal(0.0, 1.0, points.shape)


def loop(ring_mm=24.0, half_thick_mm=5.0, middle_mm=42.0):
    """A mug's handle: half a torus whose ends are in the wall, in the x-z plane."""
    along, around = rng.uniform(-np.pi / 2, np.pi / 2, 800), rng.uniform(0.0, 2 * np.pi, 800)
    out = ring_mm + half_thick_mm * np.cos(around)
    return np.column_stack(
        [middle_mm + out * np.cos(along), half_thick_mm * np.sin(around), 48.0 + out * np.sin(along)]
    )


def upper_half(points):
    return points[points[:, 2] > 48.0]


def ellipsoid(middle, half_axes):
    points = rng.normal(size=(800, 3))
    return np.array(middle) + points / np.linalg.norm(points, axis=1, keepdims=True) * half_axes


def vessel_of(radius_mm, height_mm):
    return StandingVessel(MUG.silhouette, Circle(MUG.rim.centre_mm, radius_mm, height_mm + TABLE_MM, 0.9), TABLE_MM)


CUP = vessel_of(33.0, 60.0)


def bar(begin_mm, size, z_mm, climb=0.0):
    """A biscuit, size its length outward, width and height, mm, whose outer end is lower by climb of its length."""
    points = rng.uniform(size=(800, 3)) * size
    return points - [0.0, size[1] / 2, 0.0] + [begin_mm, 0.0, z_mm] + np.outer(size[0] - points[:, 0], [0, 0, climb])


REGIONS = {  # points, vessel, height of the dish beneath both, whether they are the vessel's handle
    "mug": (loop(), MUG, 0.0, True),
    "mug whose lower half a fruit hides": (upper_half(loop()), MUG, 0.0, True),
    "egg that touches the mug": (ellipsoid((72.0, 0.0, 27.0), (27.0, 22.0, 27.0)), MUG, 0.0, False),
    "sausage that points at it": (ellipsoid((100.0, 0.0, 8.0), (55.0, 8.0, 8.0)), MUG, 0.0, False),
    "hardly measured": (loop()[: HANDLE_MIN_POINTS - 1], MUG, 0.0, False),
    "handle over a saucer": (loop(17.0, 3.5, 33.0), vessel_of(33.0, 80.0), 8.0, True),
    "biscuit that leans on the cup": (bar(36.0, (25.0, 18.0, 8.0), 12.0, climb=1.2), CUP, 12.0, False),
    "kiwifruit beside a soup bowl": (bar(95.0, (60.0, 44.0, 40.0), 10.0), vessel_of(79.0, 52.0), 0.0, False),
    "on a stand higher than the mug": (loop(), MUG, RIM_MM + 5.0, False),
}


@pytest.mark.parametrize(("points", "vessel", "dish_mm", "is_part"), REGIONS.values(), ids=REGIONS)
def test_handle_is_told_from_food_by_its_points_clear_of_the_dish_beneath(points, vessel, dish_mm, is_part):
    seen = turned(points, 40)[None]
    support = Support(TABLE_MM + dish_mm, 1.0, "floor" if dish_mm else "table")
    region = Region(np.ones(seen.shape[:2], np.bool_), support=support)
    assert _is_part_of_vessel(region, seen, Vessels([], [vessel])) == is_part
