import numpy as np
import pytest

from app.vision.geometry.masks import distance_px
from app.vision.scene.upright_sides import flat_top, with_sides
from tests.unit.vision.scene.scenes import plain_scene, slanting_rays

SHAPE = (240, 320)
CAMERA_MM = np.array([0.0, -400.0, 400.0])
HALF_MM, TOP_MM = np.array([45.0, 30.0]), 40.0  # of a block about the origin
FOCAL_PX = 500.0
RAYS = slanting_rays(SHAPE, FOCAL_PX)


def meets(height_mm):
    """(h, w, 2) where the rays meet a level."""
    direction = RAYS
    reach = (height_mm - CAMERA_MM[2]) / direction[..., 2]
    return CAMERA_MM[:2] + reach[..., None] * direction[..., :2]


def block(top_mm=TOP_MM):
    """Masks of a block's top and of its side that faces the camera."""
    top = (np.abs(meets(top_mm)) < HALF_MM).all(axis=-1)
    direction = RAYS
    reach = (-HALF_MM[1] - CAMERA_MM[1]) / direction[..., 1]
    x, z = reach * direction[..., 0], CAMERA_MM[2] + reach * direction[..., 2]
    return top, (np.abs(x) < HALF_MM[0]) & (z > 0) & (z < top_mm)


def scene_of(height_mm):
    plane = meets(0.0).astype(np.float32)
    points = np.concatenate([plane, height_mm[..., None]], axis=-1).astype(np.float32)
    seen = {"height_mm": height_mm.astype(np.float32), "points_table": points, "plane_xy_mm": plane}
    return plain_scene(SHAPE, camera_mm=CAMERA_MM, pixel_mm=1.1, **seen)


@pytest.mark.parametrize("seen", ["top", "edge of its top", "low spot"])
def test_unmeasured_side_of_a_block_is_found_below_its_top(seen):
    """Nothing in the middle of white tofu can be matched; a bubble opens in bread, or a pack's window misleads."""
    top, side = block()
    unmeasured = side | (distance_px(~top) > 5) if seen == "edge of its top" else side
    spot = (np.linalg.norm(meets(TOP_MM) - (25.0, 12.0), axis=-1) < 8.0) & (seen == "low spot")
    scene = scene_of(np.select([spot, unmeasured, top], [2.0, np.nan, TOP_MM], 0.0))
    (mask,) = with_sides([top & ~spot], scene, 0.0)
    # The top is taken two pixels too small.
    assert np.count_nonzero(mask & side) > (0.8 if spot.any() else 0.85) * np.count_nonzero(side)
    if seen == "top":
        assert np.count_nonzero(mask & ~top & ~side) < 0.03 * np.count_nonzero(mask)  # a pixel all round


def test_dome_has_no_flat_top():
    x, y = np.moveaxis(meets(20.0), -1, 0)
    heights = 45.0 * np.sqrt(np.clip(1 - (x**2 + y**2) / 45.0**2, 0, None))
    assert flat_top(heights > 0, scene_of(heights), 0.0) is None


def test_table_that_shows_below_a_top_is_no_side():
    top, side = block()
    (mask,) = with_sides([top], scene_of(np.where(top, TOP_MM, 0.0)), 0.0)
    assert np.array_equal(mask, top)
    assert np.count_nonzero(side) > 1000  # or the test would say nothing
