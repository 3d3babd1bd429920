import numpy as np

from app.vision.views.epipolar import fundamental_from_projections, projection_matrix, symmetric_epipolar_distance_px
from app.vision.views.features import is_on_sheet, match_features, undistort_to_pinhole
from tests.unit.vision.stereo_scene import BALL, SPEC, blank_views, rendered_views


def test_matches_of_a_rendered_pair_lie_on_their_epipolar_lines():
    first, second = rendered_views(BALL)
    matches = match_features(first, second)
    fundamental = fundamental_from_projections(projection_matrix(first), projection_matrix(second))
    distance = symmetric_epipolar_distance_px(
        fundamental, undistort_to_pinhole(first, matches.first_px), undistort_to_pinhole(second, matches.second_px)
    )
    assert matches.is_board.sum() == 48
    assert (distance[matches.is_food] < 2.0).sum() >= 8
    assert np.median(distance[~matches.is_board]) < 1.0


def test_pictures_without_texture_give_the_markers_corners_alone():
    matches = match_features(*blank_views())
    assert matches.are_few
    assert (len(matches), matches.beside_board) == (48, 0)
    half = SPEC.columns * SPEC.square_mm / 2  # of the sheet without its margin
    points = np.array([[half + 10.9, 0.0, 0.0], [half + 11.1, 0.0, 0.0], [np.nan, np.nan, np.nan]])
    assert is_on_sheet(blank_views()[0].marker, points).tolist() == [True, False, False]
