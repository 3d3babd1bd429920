"""A food from above and from the side: its height is what the outline from the side shows, wherever that was taken."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.geometry.masks import inward_px
from app.vision.geometry.mesh import faces_towards, sphere
from app.vision.solids.form_fit import fit_form
from app.vision.solids.forms import EXACT, FINE
from app.vision.solids.outline_snap import outline, rings_of_mask
from app.vision.solids.seen import Seen
from app.vision.solids.side_view import (
    AZIMUTH,
    ELEVATION,
    LOG_DISTANCE,
    POSE,
    SHIFT,
    SideView,
    side_view,
)
from app.vision.solids.single_starts import USUAL_HEIGHTS, single_view_forms, upright, with_usual_height
from app.vision.solids.surface_match import draw_mask
from app.vision.views.disparity import unmatched
from app.vision.views.rectification import rectify_alone
from app.vision.views.sight import Sight
from tests.unit.vision.stereo_scene import CAMERA, look_at, view_of

MIDDLE_MM = np.array([20.0, -10.0, 0.0])
FROM_ABOVE = look_at((20.0, -30.0, 400.0), (20.0, -10.0, 0.0))
SIGHT = Sight(rectify_alone(view_of(np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), FROM_ABOVE)))
PLACE = np.array([0.9, 0.15, 0.02, np.log(350.0), 130.0, 110.0])


def ellipsoid(half_mm):
    mesh = sphere(24)
    return mesh.places * half_mm + MIDDLE_MM + [0.0, 0.0, half_mm[2]], mesh


def mask_of(pixels, camera_mm, solid, shape):
    vertices, mesh = solid
    return draw_mask(pixels, mesh.faces[faces_towards(vertices, mesh.faces, camera_mm)], shape)


def seen_from(side: SideView, solid, pose=PLACE) -> SideView:
    """The side view with what it shows of a solid from a pose."""
    mask = mask_of(side.project(solid[0], pose), side.camera_mm(pose), solid, (220, 260))
    return replace(side_view(mask, side.focal_px), middle_mm=MIDDLE_MM)


def looking(focal_px=500.0) -> SideView:
    return replace(side_view(np.eye(99, dtype=bool), focal_px), middle_mm=MIDDLE_MM)


def from_above(solid, side=None) -> Seen:
    mask = mask_of(SIGHT.project(solid[0])[0], SIGHT.cameras_mm[0], solid, SIGHT.pair.shape)
    rings = rings_of_mask(mask)
    line = outline(rings, np.ones(sum(len(each.points_px) for each in rings)))
    return Seen(SIGHT, mask, inward_px(mask), (line, None), unmatched(SIGHT.pair.shape), side=side)


def fitted(solid, side, name, heights=USUAL_HEIGHTS):
    seen = from_above(solid, side)
    form = next(form for form in single_view_forms(SIGHT, seen.mask, 0.0, 0.3, heights) if form.name == name)
    begun = replace(with_usual_height(upright(form), heights), has_displacement=False)
    return fit_form(begun, seen, FINE)


def fitted_ml(solid, side, name):
    return fitted(solid, side, name).volume_ml


def test_derivatives_are_those_of_the_pixel():
    side, points = looking(), ellipsoid((30.0, 20.0, 15.0))[0][::50]
    step = 1e-5
    by_point = np.stack(
        [
            (side.project(points + way, PLACE) - side.project(points - way, PLACE)) / (2 * step)
            for way in step * np.eye(3)
        ],
        axis=-1,
    )
    assert side.pixel_gradient(points, PLACE) == pytest.approx(by_point, abs=1e-4)
    assert side.pose_gradient(points, PLACE).shape == (len(points), 2, POSE)
    apart = points - side.camera_mm(PLACE)
    assert np.linalg.norm(apart, axis=1).mean() == pytest.approx(np.exp(PLACE[LOG_DISTANCE]), rel=0.05)
    assert side.project(MIDDLE_MM[None], PLACE)[0] == pytest.approx(PLACE[SHIFT])


def test_long_food_tells_from_which_side_it_is_seen():
    solid = ellipsoid((60.0, 18.0, 18.0))
    begun = seen_from(looking(), solid).begin(solid[0])
    assert begun[AZIMUTH] == pytest.approx(PLACE[AZIMUTH], abs=np.pi / 12)
    assert begun[LOG_DISTANCE] == pytest.approx(PLACE[LOG_DISTANCE], abs=0.1)


@pytest.mark.parametrize(
    ("name", "height_mm", "elevation", "within"),
    [("ball", 50.0, 0.19, 0.1), ("ball", 64.0, 0.26, 0.05), ("slab", 30.0, 0.12, 0.1), ("slab", 16.0, 0.19, 0.3)],
)
def test_height_is_that_of_the_outline_from_the_side(name, height_mm, elevation, within):
    """The flatter the food, the more of its outline from the side is the camera's elevation, which is not told."""
    solid = ellipsoid((40.0, 32.0, height_mm / 2))
    pose = PLACE.copy()
    pose[ELEVATION] = elevation
    true_ml = 4 / 3 * np.pi * 40.0 * 32.0 * height_mm / 2 / 1000
    assert fitted_ml(solid, seen_from(looking(), solid, pose), name) == pytest.approx(true_ml, rel=within)


def test_without_the_side_the_height_is_the_usual_one():
    flat, tall = (fitted_ml(ellipsoid((40.0, 32.0, half_mm)), None, "slab") for half_mm in (8.0, 25.0))
    assert flat > 1.5 * 4 / 3 * np.pi * 40.0 * 32.0 * 8.0 / 1000
    assert tall < 0.8 * 4 / 3 * np.pi * 40.0 * 32.0 * 25.0 / 1000


@pytest.mark.parametrize(
    ("name", "solid"),
    [
        ("ball", (40.0, 32.0, 15.0)),
        ("slab", (40.0, 32.0, 8.0)),
        ("lying", (60.0, 24.0, 18.0)),
        ("ring", (40.0, 40.0, 12.0)),
    ],
)
def test_food_whose_height_is_known_has_it_over_its_width_in_every_family(name, solid):
    fit = fitted(ellipsoid(solid), None, name, {**USUAL_HEIGHTS, name: (0.3, 0.01)})
    across = np.ptp(fit.form.vertices(fit.unknowns, EXACT), axis=0)
    assert across[2] / np.sqrt(across[0] * across[1]) == pytest.approx(0.3, rel=0.1)
