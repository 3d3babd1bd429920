"""The paper's stereo as printed, on views whose geometry is known."""

from dataclasses import replace

import numpy as np
import pytest

from app.core.errors import Failure
from app.vision.paper import printed_stereo
from app.vision.paper.printed_stereo import reconstruct_as_printed
from app.vision.views.epipolar import fundamental_from_projections, projection_matrix
from app.vision.views.features import Matches
from app.vision.views.rectification import rectify_by_poses
from app.vision.views.relative_pose import RefinedViews
from tests.unit.vision.stereo_scene import BALL, CAMERA, rendered_views
from tests.unit.vision.views.test_epipolar import project

MIDDLE = np.array([*BALL.centre_mm, BALL.radius_mm])


def ball_matches(views, count=30):
    """Exact matches: the board's corners, and points of the ball that both cameras see."""
    rng = np.random.default_rng(5)
    offsets = rng.normal(size=(20 * count, 3))
    offsets /= np.linalg.norm(offsets, axis=1, keepdims=True)
    points = MIDDLE + BALL.radius_mm * offsets
    seen = np.all([np.einsum("ij,ij->i", view.centre_mm - points, offsets) > 0 for view in views], axis=0)
    points = points[seen][:count]
    corners = [view.required_marker.corners_px for view in views]
    is_board = np.arange(len(corners[0]) + len(points)) < len(corners[0])
    pixels = [np.concatenate([own, project(view, points)]) for own, view in zip(corners, views, strict=True)]
    return Matches(*pixels, is_board, ~is_board)


def ball_mask(view, pair):
    height, width = pair.shape
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    rays = pair.rays(np.column_stack([columns.ravel(), rows.ravel()]).astype(float)) @ pair.rotation
    middle = MIDDLE - view.centre_mm
    along = rays @ middle
    reach = (rays**2).sum(axis=1) * (middle @ middle - (0.95 * BALL.radius_mm) ** 2)  # clear of the outline
    return (along**2 > reach).reshape(height, width)


@pytest.fixture(scope="module")
def scene():
    views = rendered_views(BALL)
    pair = rectify_by_poses(*views)
    return views, ball_matches(views), pair, ball_mask(views[0], pair)


def reconstructed(scene, seed=0):
    views, matches, pair, mask = scene
    refined = RefinedViews(*views, np.zeros(3), 0)
    return reconstruct_as_printed(refined, matches, pair, [mask], np.random.default_rng(seed))


def test_exact_matches_give_p_zero_q_focal_times_baseline_and_points_on_the_ball(scene):
    stereo = reconstructed(scene)
    assert not isinstance(stereo, Failure)
    assert len(set(stereo.drawn)) == 16
    # Matches without noise leave rounding only: eq. 14 becomes eq. 11.
    assert abs(stereo.depth.p_mm) < 0.1
    assert np.isclose(stereo.depth.q_mm_px, CAMERA.fx * scene[2].baseline_mm, rtol=1e-3)
    assert np.count_nonzero(stereo.surfaces[0]) > 0.8 * np.count_nonzero(stereo.masks[0])
    points = stereo.points_mm[stereo.surfaces[0]].astype(float)
    off = np.linalg.norm(stereo.to_table(points) - MIDDLE, axis=1) - BALL.radius_mm
    assert np.median(np.abs(off)) < 1.5  # a quarter of a pixel of disparity is 0.7 mm of depth here
    first, second = scene[0]
    turned = stereo.table_to_depth_rotation  # whose depth axis is across the baseline and towards the scene
    assert np.allclose(turned @ turned.T, np.eye(3))
    baseline = turned @ (second.centre_mm - first.centre_mm)
    assert np.allclose(baseline, [scene[2].baseline_mm, 0.0, 0.0], atol=0.1)
    assert (turned @ (MIDDLE - first.centre_mm))[2] > 0


def test_draws_of_few_matches_with_an_epipole_in_the_photograph_or_swapped_depths_fail(scene, monkeypatch):
    views, matches, pair, mask = scene
    few = Matches(matches.first_px[:15], matches.second_px[:15], matches.is_board[:15], matches.is_food[:15])
    assert reconstructed((views, few, pair, mask)).code == "too_few_matches"
    still = Matches(matches.first_px, matches.first_px, matches.is_board, matches.is_food)  # no parallax at all
    assert reconstructed((views, still, pair, mask)).code == "draw_unusable"
    # As if the second camera stood in front of the first, on its way to the ball.
    ahead = replace(views[1], translation_mm=-views[1].rotation @ (0.7 * views[0].centre_mm + 0.3 * MIDDLE))
    fundamental = fundamental_from_projections(projection_matrix(views[0]), projection_matrix(ahead))
    monkeypatch.setattr(printed_stereo, "fundamental_from_points", lambda *_: fundamental)
    assert reconstructed((views, matches, pair, mask)).code == "draw_unusable"
