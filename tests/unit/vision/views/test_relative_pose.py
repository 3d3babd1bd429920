from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.vision.board.camera import DIAGONAL_35MM, camera_from_exif
from app.vision.board.pose import FOCAL_SPREAD_UNKNOWN
from app.vision.views.epipolar import fundamental_from_projections, projection_matrix, symmetric_epipolar_distance_px
from app.vision.views.features import Matches
from app.vision.views.relative_pose import refine_views
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.views.test_epipolar import matches_of
from tests.unit.vision.views.test_focal_doubt import GUESS
from tests.unit.vision.views.test_focal_doubt import pair as board_views


def row_gap_px(first, second, matches):
    fundamental = fundamental_from_projections(projection_matrix(first), projection_matrix(second))
    return np.median(symmetric_epipolar_distance_px(fundamental, matches.first_px, matches.second_px))


def disturbed(view, degrees):
    turn = cv2.Rodrigues(np.radians(degrees) * np.array([1.0, 0.5, -0.3]))[0]
    return replace(view, rotation=turn @ view.rotation, translation_mm=turn @ view.translation_mm)


def test_matches_bring_rows_together_again():
    first, second = blank_views()
    matches = matches_of(first, second, count=60)
    wrong = disturbed(second, 0.15)
    refined = refine_views(first, wrong, matches)
    assert row_gap_px(first, wrong, matches) > 1.0
    assert row_gap_px(refined.first, refined.second, matches) < 0.05
    assert refined.matches == 60


def test_few_matches_leave_the_pose_to_the_marker():
    first, second = blank_views()
    matches = matches_of(first, second, count=5)
    shifted = replace(matches, second_px=matches.second_px + np.where(matches.is_board, 0.0, 3.0)[:, None])
    refined = refine_views(first, second, shifted)
    assert refined.matches == 0
    assert np.allclose(refined.second.rotation, second.rotation, atol=1e-3)


@pytest.mark.parametrize("exif_error", [-0.05, 0.05])
def test_focal_length_that_exif_tells_wrong_is_put_right(exif_error):
    views = blank_views(baseline_mm=90.0)
    matches = matches_of(*views, count=120)
    diagonal = np.hypot(views[0].camera.width, views[0].camera.height)
    told_mm = views[0].camera.fx / diagonal * DIAGONAL_35MM * (1 + exif_error)
    guessed = []
    for view in views:
        photo = replace(view.photo, focal_35mm=told_mm)
        guessed.append(replace(view, photo=photo, camera=camera_from_exif(photo)))
    refined = refine_views(guessed[0], guessed[1], matches)
    # Without noise only the prior's pull is left: 5 % of a spread of 8 % against some 0.5 % that the points tell.
    assert abs(refined.first.camera.fx / views[0].camera.fx - 1) < 0.005
    assert np.allclose(refined.first.centre_mm, views[0].centre_mm, atol=3.0)
    assert abs(refined.first.camera.distortion[0]) < 0.02
    assert refined.first.camera.source == "exif"


def test_focal_length_that_nothing_tells_stays_at_the_prior_with_its_spread():
    first, second = board_views("above", focal_scale=1.0)
    nothing = np.empty((0, 2))
    refined = refine_views(first, second, Matches(nothing, nothing, np.empty(0, np.bool_), np.empty(0, np.bool_)))
    # The corners' noise hardly tells of it. Residuals in rays, which a longer lens makes smaller, drew it up by 0.1.
    assert abs(np.log(refined.first.camera.fx / GUESS.fx)) < 0.2 * FOCAL_SPREAD_UNKNOWN
    steps = [np.log(doubt[0].camera.fx / refined.first.camera.fx) for doubt in refined.doubts]
    assert np.sqrt(np.square(steps).sum()) == pytest.approx(FOCAL_SPREAD_UNKNOWN, rel=0.1)
