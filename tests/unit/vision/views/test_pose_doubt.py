from dataclasses import replace

import numpy as np
import pytest

from app.vision.views.focal_doubt import FocalDoubt
from app.vision.views.pose_doubt import LEAST_SD, volume_doubt
from app.vision.views.relative_pose import RefinedViews, refine_views
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.views.test_epipolar import matches_of

FOODS = np.array([[80.0, 20.0, 30.0], [90.0, 10.0, 40.0], [np.nan, np.nan, np.nan]], np.float32)


def enlarged(view, factor):
    return replace(view, translation_mm=view.translation_mm * factor)


@pytest.mark.parametrize("factors", [(1.01,), (1.01, 1 / 1.01)])
def test_views_that_see_everything_larger_doubt_three_times_that_and_doubts_add_up_in_squares(factors):
    first, second = blank_views()
    doubts = tuple((enlarged(first, factor), enlarged(second, factor)) for factor in factors)
    sd = volume_doubt(RefinedViews(first, second, np.zeros(3), 50, doubts), FOODS).sd
    assert sd == pytest.approx(np.hypot(np.sqrt(len(factors)) * 3 * np.log(1.01), LEAST_SD), rel=1e-6)


def test_matches_beside_the_marker_leave_less_doubt_than_the_marker_alone():
    views = blank_views()
    few, many = (volume_doubt(refine_views(*views, matches_of(*views, count=count)), FOODS).sd for count in (5, 120))
    assert LEAST_SD < many < 0.9 * few
    assert few < 0.2
    refined, nowhere = refine_views(*views, matches_of(*views, count=60)), np.full((4, 3), np.nan, np.float32)
    assert volume_doubt(refined, nowhere) == volume_doubt(refined, np.zeros((1, 3), np.float32))  # at the marker


def test_doubt_is_never_less_than_that_of_the_focal_length():
    views = blank_views()
    farther = tuple(enlarged(view, 1.1) for view in views)
    doubt = volume_doubt(RefinedViews(*views, np.zeros(3), 50), FOODS, FocalDoubt(0.1, views, farther))
    assert doubt.focal_sd == pytest.approx(3 * np.log(1.1))
    assert doubt.sd >= doubt.focal_sd
    refined = RefinedViews(*views, np.zeros(3), 50, (farther,))  # the covariance holds it: not counted twice
    assert volume_doubt(refined, FOODS, FocalDoubt(0.1, views, farther)).sd == volume_doubt(refined, FOODS).sd
