import cv2
import numpy as np
import pytest

from app.vision.geometry.mesh import faces_towards, sphere
from app.vision.solids.surface_match import draw_mask, draw_parallax, measure_along
from app.vision.views.rectification import rectify_by_poses
from app.vision.views.sight import Sight
from tests.unit.vision.stereo_scene import Ball, blank_views, true_parallax

SIGHT = Sight(rectify_by_poses(*blank_views()))
SHAPE = SIGHT.pair.shape
MESH = sphere(16)
MIDDLE_MM, RADIUS_MM = np.array([60.0, 0.0, 30.0]), 30.0
BALL = MIDDLE_MM + RADIUS_MM * MESH.places
RIM_PX = 3  # a pixel drawn at the rim may be the other side's


def ball_parallax():
    """(H, W) of the ball by casting rays, NaN beside it."""
    with_ball, without = true_parallax(SIGHT.pair, Ball((60.0, 0.0), RADIUS_MM)), true_parallax(SIGHT.pair, None)
    return np.where(with_ball > without + 1e-3, with_ball, np.nan)


def textures(parallax, offset_px, noise=0.5, contrast=25.0, seed=0):
    """Both views of a textured surface: the first is the second where the true parallax says."""
    rng = np.random.default_rng(seed)
    second = cv2.GaussianBlur(rng.normal(0, 1, SHAPE), (0, 0), 1.6)
    second = (128 + contrast * second / second.std()).astype(np.float32)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    first = cv2.remap(second, x - np.nan_to_num(parallax + offset_px).astype(np.float32), y, cv2.INTER_CUBIC)
    return tuple((each + rng.normal(0, noise, SHAPE)).astype(np.float32) for each in (first, second))


def covered_in(view):
    pixels = SIGHT.in_view(*SIGHT.project(BALL), view)
    return draw_mask(pixels, MESH.faces[faces_towards(BALL, MESH.faces, SIGHT.cameras_mm[view])], SHAPE)


TRUTH, SECOND = ball_parallax(), covered_in(1)


MASK = np.isfinite(TRUTH)
INNER = cv2.distanceTransform(MASK.astype(np.uint8), cv2.DIST_L2, 5) > RIM_PX


def measured(grey, mask=MASK, vertices=BALL):
    """(H, W) parallax and sd."""
    found = measure_along(SIGHT, grey, (mask, SECOND), vertices, MESH)
    left, top = found.origin
    out = np.full((2, *SHAPE), np.nan)
    height, width = found.parallax_px.shape
    out[:, top : top + height, left : left + width] = found.parallax_px, found.sd_px
    return out


def test_drawn_parallax_and_mask_are_those_of_rays_cast_at_the_ball():
    drawn, (left, top) = draw_parallax(SIGHT, BALL, MESH, SHAPE)
    height, width = drawn.shape
    truth = TRUTH[top : top + height, left : left + width]
    inner = INNER[top : top + height, left : left + width]
    assert np.isfinite(drawn[inner]).all()
    # Triangles cut off 0.05 mm of the ball, which is a few hundredths of a pixel but where it slants away at the rim.
    assert np.quantile(np.abs(drawn - truth)[inner], 0.95) < 0.15
    assert np.abs(drawn - truth)[inner].max() < 0.5
    assert np.count_nonzero(np.isfinite(drawn) != np.isfinite(truth)) < 0.03 * MASK.sum()
    covered = covered_in(0)
    assert not (INNER & ~covered).any()
    assert np.isclose(covered.sum(), MASK.sum(), rtol=0.03)


@pytest.mark.parametrize("offset_px", [-2.4, -0.37, 1.8])
def test_parallax_off_the_surface_is_recovered(offset_px):
    parallax, sd = measured(textures(TRUTH, offset_px))
    off = (parallax - TRUTH - offset_px)[INNER]
    known = np.isfinite(off)
    assert known.mean() > 0.9
    assert abs(np.median(off[known])) < 0.05
    assert np.quantile(np.abs(off[known]), 0.9) < 0.15
    assert (sd[INNER][known] > 0).all()


def test_gloss_that_moves_with_the_camera_does_not_draw_the_surface_to_its_mirror_image():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    row, column = np.argwhere(MASK).mean(axis=0)
    skin = textures(TRUTH, 0.0, contrast=2.0)
    at = column, column - TRUTH[int(row), int(column)] + 3.0  # 3 px less parallax than the surface has
    glossy = [
        (view + 90.0 * np.exp(-((x - middle) ** 2 + (y - row) ** 2) / (2 * 20.0**2))).astype(np.float32)
        for view, middle in zip(skin, at, strict=True)
    ]
    is_gloss = np.hypot(x - column, y - row) < 25.0
    off = (measured(glossy)[0] - TRUTH)[is_gloss]
    assert abs(np.nanmedian(off)) < 0.25  # 0.5 by grey levels as they are


def test_noise_on_plain_skin_is_known_to_tell_nothing():
    shade = np.linspace(100.0, 160.0, SHAPE[1], dtype=np.float32) * np.ones(SHAPE, np.float32)
    noisy = [shade + np.random.default_rng(seed).normal(0, 6.0, SHAPE).astype(np.float32) for seed in (1, 2)]
    _, sd = measured(noisy)
    assert (sd[INNER] < 1.0).mean() < 0.1


def test_nothing_is_measured_outside_the_mask():
    half = MASK.copy()
    half[:, : int(np.argwhere(MASK)[:, 1].mean())] = False
    parallax, sd = measured(textures(TRUTH, 0.3), half)
    assert np.isnan(parallax[~half]).all()
    assert np.isnan(sd[~half]).all()
    assert np.isfinite(parallax[half & INNER]).mean() > 0.9


@pytest.mark.parametrize("inward_px", [(3, 8), (8, 15), (15, 30)])
def test_a_bright_table_behind_plain_skin_does_not_bias_the_parallax_within_the_outline(inward_px):
    skin = textures(TRUTH, 0.0, contrast=1.5)
    on_table = [np.where(mask, each, np.float32(250.0)) for mask, each in zip((MASK, SECOND), skin, strict=True)]
    blurred = tuple(cv2.GaussianBlur(each, (0, 0), 1.0) for each in on_table)
    inward = cv2.distanceTransform(MASK.astype(np.uint8), cv2.DIST_L2, 5)
    off = (measured(blurred)[0] - TRUTH)[(inward > inward_px[0]) & (inward <= inward_px[1])]
    assert np.isfinite(off).mean() > 0.5
    assert abs(np.nanmedian(off)) < 0.1  # 0.5 to 1.2 by a mean across the rim


def test_a_bright_table_behind_does_not_bend_what_is_measured_along_the_rim():
    grey = textures(TRUTH, 0.0, contrast=5.0)
    on_table = tuple(
        cv2.GaussianBlur(np.where(mask, each, np.float32(250.0)), (0, 0), 1.0)
        for mask, each in zip((MASK, SECOND), grey, strict=True)
    )
    inward = cv2.distanceTransform(MASK.astype(np.uint8), cv2.DIST_L2, 5)
    off = (measured(on_table)[0] - TRUTH)[(inward > RIM_PX) & (inward < 12)]
    assert np.isfinite(off).mean() > 0.6
    assert np.nanquantile(np.abs(off), 0.9) < 0.2


def test_flat_grey_noise_alone_offsets_beyond_reach_and_surfaces_out_of_sight_are_not_measured():
    flat = np.full(SHAPE, 128.0, np.float32)
    assert np.isnan(measured((flat, flat))[0]).all()
    rng = np.random.default_rng(6)
    noise = tuple((128 + rng.normal(0, 2, SHAPE)).astype(np.float32) for _ in range(2))
    assert np.isfinite(measured(noise)[0][INNER]).mean() < 0.02
    assert np.isfinite(measured(textures(TRUTH, 9.0))[0][INNER]).mean() < 0.05
    assert measure_along(SIGHT, (flat, flat), (MASK, SECOND), BALL + np.array([5000.0, 0.0, 0.0]), MESH) is None


def test_parallax_at_pixels_is_that_of_the_grid_and_nan_beside_it():
    found = measure_along(SIGHT, textures(TRUTH, 0.3), (MASK, SECOND), BALL, MESH)
    row, column = np.argwhere(INNER)[INNER.sum() // 2]
    value, sd = found.at(np.array([[column + 0.3, row - 0.3], [-50.0, 10.0], [1e5, 1e5]]))
    left, top = found.origin
    assert value[0] == found.parallax_px[row - top, column - left]
    assert sd[0] == found.sd_px[row - top, column - left]
    assert np.isnan(value[1:]).all()
    assert np.isnan(sd[1:]).all()
