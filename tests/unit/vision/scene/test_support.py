from dataclasses import replace

import numpy as np
import pytest

from app.vision.geometry.topview import TableTrend, fit_table_trend, view_from_above
from app.vision.scene.dish import Dish, find_dishes, solid_cells
from app.vision.scene.layout import without_heights
from app.vision.scene.support import TYPICAL_BOARD_MM, TYPICAL_RIM_MM, find_support, with_measured_rim
from app.vision.scene.vessel import describe_vessel
from tests.unit.vision.scene.scenes import plain_scene

SHAPE = (300, 400)


def scene_of(height_of, noise_mm=0.3):
    """Seen from so high above that every ray is nearly upright; heights of the table itself are zero."""
    rows, columns = np.indices(SHAPE)
    x, y = columns - 200.0, 150.0 - rows
    height = height_of(x, y) + np.random.default_rng(0).normal(0, noise_mm, SHAPE)
    points = np.stack([x, y, height], -1).astype(np.float32)
    seen = {"height_mm": height.astype(np.float32), "points_table": points, "plane_xy_mm": points[..., :2]}
    return plain_scene(SHAPE, camera_mm=np.array([0.0, 0.0, 600.0]), **seen), np.hypot(x, y)


def measured(scene):
    points = scene.points_table[np.isfinite(scene.points_table[..., 2])]
    view = view_from_above(points, points[:, 2])
    trend = fit_table_trend(points)
    dishes = find_dishes(view, solid_cells(view, 1.0), 0.3, np.random.default_rng(0), lambda dish: dish)
    return view, next(iter(dishes), None), trend


def support_of(scene, mask):
    view, dish, _ = measured(scene)
    return find_support(scene, view, dish, TableTrend(np.zeros(6), 0.1), mask, mask)


def plate(floor_mm):
    def heights(x, y):
        r = np.hypot(x, y)
        return np.select([r < 30, r < 100, r < 110], [40.0, floor_mm, 14.0], 0.0)

    return heights


def bowl(x, y):
    r, gap = np.hypot(x, y), np.nan
    return np.select([r < 60, r < 68, r < 73, r < 80], [38.0, gap, 48.0, gap], 0.0)


SUPPORTS = {  # heights, the food's radius, source, height and its tolerance, most doubt in mm
    "bare table": (lambda x, y: np.where(np.hypot(x, y) < 30, 40.0, 0.0), 30, "table", 0.0, 0.3, 1.0),
    "low floor of a plate": (plate(2.0), 30, "floor", 2.0, 3.0, 1.5),
    "high floor of a plate": (plate(5.0), 30, "floor", 5.0, 3.0, 1.5),
    "floor that was not measured": (plate(np.nan), 30, "floor", 5.0, 5.0, None),
    "inside of a filled bowl": (bowl, 60, "bowl", 24.0, 24.0, None),
}


@pytest.mark.parametrize(("heights", "radius_mm", "source", "mm", "off_mm", "sd_mm"), SUPPORTS.values(), ids=SUPPORTS)
def test_support_is_measured_around_the_food_or_guessed_with_more_doubt(heights, radius_mm, source, mm, off_mm, sd_mm):
    scene, radius = scene_of(heights)
    support = support_of(scene, radius < radius_mm)
    assert support.source == source
    assert support.height_mm == pytest.approx(mm, abs=off_mm)
    if sd_mm is None:
        assert support.sd_mm > 2.0
    else:
        assert support.sd_mm < sd_mm
        assert abs(support.height_mm - mm) < 2 * support.sd_mm


def test_support_on_a_board_is_its_top_with_its_doubt():
    scene, radius = scene_of(lambda x, y: np.where(np.hypot(x, y) < 30, 50.0, 0.0))
    view, _, _ = measured(scene)
    inward = (110.0 - np.linalg.norm(view.centres_mm(), axis=-1)).astype(np.float32)
    board = Dish(inward, 15.0, floor_mm=15.0, floor_sd_mm=0.8)
    mask = radius < 30
    support = find_support(scene, view, board, TableTrend(np.zeros(6), 0.1), mask, mask)
    assert (support.source, support.height_mm) == ("board", pytest.approx(15.0))
    assert 0.8 < support.sd_mm < 1.2


def test_bowl_is_described_by_its_rim_and_a_plate_is_no_vessel():
    scene, _ = scene_of(bowl)
    view, dish, trend = measured(scene)
    vessel = describe_vessel(scene, view, dish, trend)
    assert vessel.rim_mm == pytest.approx(48.0, abs=1)
    assert vessel.radius_mm == pytest.approx(70.0, abs=4)
    assert vessel.wall_mm.shape[1] == 2
    plate, _ = scene_of(lambda x, y: np.where(np.hypot(x, y) < 100, 3.0, np.where(np.hypot(x, y) < 110, 14.0, 0.0)))
    view, dish, trend = measured(plate)
    assert dish is not None
    assert describe_vessel(plate, view, dish, trend) is None


@pytest.mark.parametrize("plane_mm", [0.0, 13.0])
def test_floor_is_known_by_the_rim_when_the_plane_is_the_rims(plane_mm):
    """plane_mm: height over the table of what was taken for the table; true floor 3 mm over it, rim 14 mm."""
    scene, radius = scene_of(
        lambda x, y: np.where((np.hypot(x, y) > 100) & (np.hypot(x, y) < 110), 14.0 - plane_mm, np.nan)
    )
    view = view_from_above(np.array([[-200.0, -150.0, 0.0], [200.0, 150.0, 0.0]], np.float32), np.zeros(2, np.float32))
    dish = Dish((110.0 - np.linalg.norm(view.centres_mm(), axis=-1)).astype(np.float32), TYPICAL_RIM_MM)
    moved = with_measured_rim(dish, view, scene)
    assert moved.rim_mm == pytest.approx(14.0 - plane_mm, abs=0.5)
    mask = radius < 30
    support = find_support(without_heights(scene), view, moved, TableTrend(np.zeros(6), 0.1), mask, mask)
    assert abs(support.height_mm - (3.0 - plane_mm)) < support.sd_mm
    assert support.sd_mm < 5.0
    unmeasured, _ = scene_of(lambda x, y: np.full_like(x, np.nan))
    assert with_measured_rim(dish, view, unmeasured) is None
    board = replace(dish, floor_mm=TYPICAL_BOARD_MM)
    assert with_measured_rim(board, view, scene).floor_mm == pytest.approx(14.0 - plane_mm, abs=0.5)  # its top
