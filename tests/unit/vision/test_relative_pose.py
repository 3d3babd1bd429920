from dataclasses import replace

import cv2
import numpy as np

from app.vision.features import Matches
from app.vision.relative_pose import refine_views
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.test_epipolar import matches_of


def row_gap_px(first, second, matches):
    from app.vision.epipolar import fundamental_from_projections, projection_matrix, symmetric_epipolar_distance_px

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


def test_true_views_stay_as_they_are():
    first, second = blank_views()
    refined = refine_views(first, second, matches_of(first, second))
    assert np.allclose(refined.first.centre_mm, first.centre_mm, atol=0.5)
    assert abs(refined.second.camera.fx / second.camera.fx - 1) < 1e-3


def test_few_matches_leave_the_pose_to_the_marker():
    first, second = blank_views()
    matches = matches_of(first, second, count=5)
    shifted = Matches(
        matches.first_px,
        matches.second_px + np.where(matches.is_board, 0.0, 3.0)[:, None],
        matches.is_board,
        matches.is_food,
    )
    refined = refine_views(first, second, shifted)
    assert refined.matches == 0
    assert np.allclose(refined.second.rotation, second.rotation, atol=1e-3)
