"""Liquids in vessels: rims and surfaces drawn as they project in both views, and volumes of insides that are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.vision.geometry.topview import TableTrend
from app.vision.model import ImageArray
from app.vision.scene.filled_vessel import find_vessels, inside_of_model, measure_liquid, recognise
from app.vision.scene.liquid_level import Level
from app.vision.scene.rims import Circle, circle_points
from app.vision.vessel_library import VesselModel
from app.vision.views.rectification import RectifiedPair
from app.vision.views.sight import Sight

SHAPE = (700, 900)
TABLE = TableTrend(np.zeros(6), 0.5)
WALL, INSIDE, TEA, CLOTH = (200, 205, 210), (140, 145, 150), (20, 45, 80), (110, 120, 90)
FINE = 8  # bits of a pixel's fraction in cv2's drawing


def _pair() -> RectifiedPair:
    """Two cameras 450 mm over the table, tilted by 40 degrees from straight down, 70 mm apart."""
    tilt = np.radians(40)
    rotation = np.array([[1.0, 0, 0], [0, -np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), -np.cos(tilt)]])
    first = np.array([-35.0, -380.0, 450.0])
    focal, baseline, centre = 900.0, 70.0, (450.0, 350.0)
    a, b = -rotation[:2, 2] / first[2] * baseline
    c = focal * baseline * -rotation[2, 2] / first[2] - a * centre[0] - b * centre[1]
    blank = np.zeros((*SHAPE, 3), np.uint8)
    seen = np.ones(SHAPE, np.bool_)
    grid = np.zeros((*SHAPE, 2), np.float32)
    plane = (float(a), float(b), float(c))
    return RectifiedPair(blank, blank, seen, grid, focal, centre, rotation, first, baseline, plane, (-5.0, 60.0))


def _ring(pair: RectifiedPair, view: int, radius: float, z: float) -> np.ndarray:
    sight = Sight(pair)
    pixels = sight.in_view(*sight.project(circle_points(np.array([0.0, 0.0, radius, z]), 400)), view)
    return np.rint(pixels * 2**FINE).astype(np.int32)


def _fill(image: ImageArray, outline: np.ndarray, colour: tuple[int, ...]) -> None:
    cv2.fillPoly(image, [outline], colour, cv2.LINE_AA, FINE)


def _with_mug(pair: RectifiedPair, radius: float, rim_mm: float, level_mm: float | None) -> RectifiedPair:
    """An upright mug at the origin, 3 mm thick, filled to level_mm; empty: None."""
    views: list[ImageArray] = []
    for view in (0, 1):
        image, opening = np.full((*SHAPE, 3), CLOTH, np.uint8), np.zeros(SHAPE, np.uint8)
        interior, rim = np.full_like(image, INSIDE), _ring(pair, view, radius, rim_mm)
        _fill(image, cv2.convexHull(np.vstack([_ring(pair, view, radius, 0.0), rim])), (170, 175, 180))
        _fill(image, rim, WALL)
        if level_mm is not None:
            _fill(interior, _ring(pair, view, radius - 3.0, level_mm), TEA)
        _fill(opening, _ring(pair, view, radius - 3.0, rim_mm), (255,))
        share = opening[..., None] / 255.0
        views.append(np.asarray(np.rint(image * (1 - share) + interior * share), np.uint8))
    return replace(pair, first_bgr=views[0], second_bgr=views[1])


def _with_glass(radius: float, rim_mm: float, level_mm: float, narrower_mm: float = 0.0) -> RectifiedPair:
    """An upright glass at the origin whose thin wall hides nothing, narrower_mm at the tea than at its rim."""
    pair, views = _pair(), [np.full((*SHAPE, 3), CLOTH, np.uint8) for _ in range(2)]
    for view, image in enumerate(views):
        foot, tea = (_ring(pair, view, radius - narrower_mm, z) for z in (4.0, level_mm))
        _fill(image, cv2.convexHull(np.vstack([foot, tea])), (30, 70, 120))
        _fill(image, tea, TEA)
        cv2.polylines(image, [_ring(pair, view, radius, rim_mm)], True, (40, 40, 40), 1, cv2.LINE_AA, FINE)
    return replace(pair, first_bgr=views[0], second_bgr=views[1])


def _vessels(pair: RectifiedPair, library: tuple[VesselModel, ...] = ()) -> list:
    nothing = np.full((*SHAPE, 3), np.nan, np.float32)
    return find_vessels(pair, nothing, TABLE, np.zeros(SHAPE, np.bool_), library).filled


def _rim(radius: float, height: float) -> Circle:
    return Circle(np.zeros(2), radius, height, 1.0)


def _level(radius: float, height: float, sd: float = 0.5) -> Level:
    return Level(height, radius, (sd, sd))


def test_drawn_mug_is_measured_and_recognised_in_the_library_and_filled_to_its_level() -> None:
    model = VesselModel("blue mug", "mug", 78.0, 85.0, None, ((39.0, 5.0), (39.0, 85.0)))
    (vessel,) = _vessels(_with_mug(_pair(), 42.0, 85.0, 65.0), (model,))
    assert vessel.flags == ("vessel_library",)
    assert not vessel.level.is_in_glass
    # The circle may lie on either edge of the 3 mm wide rim; a pixel spans 0.6 mm, and 1.3 mm of height.
    assert 38.0 < vessel.rim.radius_mm < 43.0
    assert vessel.rim.height_mm == pytest.approx(85.0, abs=2.5)
    assert vessel.level.height_mm == pytest.approx(65.0, abs=1.5)
    assert vessel.level.radius_mm == pytest.approx(39.0, abs=1.5)
    truth = np.pi * 39.0**2 * 60.0 / 1000
    assert vessel.liquid.volume_ml == pytest.approx(truth, rel=0.05)  # 3 mm of level at most
    assert recognise(_rim(40.0, 90.0), 0.0, (VesselModel("tall", "glass", 78.0, 140.0, 500.0),)) is None


def test_level_of_tea_is_read_through_a_drawn_glass_and_all_below_it_is_outlined() -> None:
    (vessel,) = _vessels(_with_glass(36.0, 100.0, 60.0))
    assert vessel.level.is_in_glass
    assert vessel.level.height_mm == pytest.approx(60.0, abs=2.0)  # steps of 1 mm, bands of 3 mm
    assert vessel.level.radius_mm == pytest.approx(36.0, abs=1.5)
    assert np.count_nonzero(vessel.content) > 0.5 * np.count_nonzero(vessel.silhouette)


def test_circle_low_in_a_glass_and_as_wide_as_its_rim_is_its_foot_and_no_surface() -> None:
    assert _vessels(_with_glass(36.0, 100.0, 20.0)) == []
    read = _vessels(_with_glass(36.0, 100.0, 20.0, narrower_mm=3.0))
    assert [vessel.level.height_mm for vessel in read] == [pytest.approx(20.0, abs=2.0)]


def test_empty_table_and_empty_mug_have_no_liquid() -> None:
    pair = _pair()
    rng = np.random.default_rng(1)
    cloth = rng.integers(90, 130, (*SHAPE, 3)).astype(np.uint8)
    flat = replace(pair, first_bgr=cloth, second_bgr=cloth)
    assert _vessels(flat) == []
    assert _vessels(_with_mug(pair, 42.0, 85.0, None)) == []


def test_twice_the_lengths_of_a_library_vessel_hold_eight_times_as_much() -> None:
    small = VesselModel("a", "bowl", 120.0, 50.0, None, ((20.0, 5.0), (50.0, 20.0), (60.0, 50.0)))
    large = VesselModel("b", "bowl", 240.0, 100.0, None, ((40.0, 10.0), (100.0, 40.0), (120.0, 100.0)))
    one, eight = inside_of_model(small).volume_ml(40.0), inside_of_model(large).volume_ml(80.0)
    assert eight == pytest.approx(8 * one, rel=1e-3)  # steps of height differ
    cup = VesselModel("c", "cup", 76.0, 55.0, 170.0)  # a frustum of a capacity holds it to the brim
    assert inside_of_model(cup).volume_ml(55.0) == pytest.approx(170.0, rel=1e-6)


def test_usual_inside_of_an_upright_mug_is_nearly_a_cylinder() -> None:
    liquid = measure_liquid(_rim(42.0, 90.0), _level(39.0, 70.0), 0.0)
    cylinder = np.pi * 39.0**2 * 65.0 / 1000
    assert 0.9 * cylinder < liquid.volume_ml < cylinder
    assert liquid.is_measurable
    over_the_floor = measure_liquid(_rim(80.0, 45.0), _level(50.0, 8.0, 1.5), 0.0)
    assert not over_the_floor.is_measurable


def test_bowl_in_which_food_stands_up_from_a_floor_has_no_level_and_is_none_of_soup() -> None:
    """The middle of what is measured may lie as high as the edge that was taken for a surface's."""
    pair = _with_mug(_pair(), 80.0, 40.0, 25.0)
    unseen = np.zeros(SHAPE, np.bool_)
    level, foods = _flat_top(pair, 25.0, 60.0), _flat_top(pair, 25.0, 60.0)
    foods[..., 2] += np.where(foods[..., 0] < -20.0, 30.0, -5.0).astype(np.float32)
    assert len(find_vessels(pair, level, TABLE, unseen).filled) == 1
    assert len(find_vessels(pair, foods, TABLE, unseen).filled) == 0


def _flat_top(pair: RectifiedPair, height_mm: float, half_mm: float) -> np.ndarray:
    """(H, W, 3) points of a block's top around the origin, nothing elsewhere."""
    rows, columns = np.indices(SHAPE)
    pixels = (np.stack([columns, rows], -1) - pair.centre_px) / pair.focal_px
    rays = np.dstack([pixels, np.ones(SHAPE)])
    rays = rays @ pair.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        points = pair.first_centre_mm + rays * ((height_mm - pair.first_centre_mm[2]) / rays[..., 2])[..., None]
    points[np.abs(points[..., :2]).max(axis=-1) > half_mm] = np.nan
    return np.asarray(points, np.float32)


def test_circle_printed_on_a_pack_is_no_cup() -> None:
    """What lies around a rim falls to the table; around a printed circle the pack's top goes on."""
    pair = _with_mug(_pair(), 32.0, 60.0, 45.0)
    unseen = np.zeros(SHAPE, np.bool_)
    assert len(find_vessels(pair, _flat_top(pair, 60.0, 90.0), TABLE, unseen).filled) == 0
    assert len(find_vessels(pair, _flat_top(pair, 0.0, 90.0), TABLE, unseen).filled) == 1
