from dataclasses import replace

import numpy as np

from app.vision.trace import Trace
from app.vision.views.relative_pose import RefinedViews
from tests.unit.vision.stereo_scene import blank_views


def test_lens_is_reported_with_where_it_is_from():
    first, second = blank_views()
    guessed = replace(second, camera=replace(second.camera, source="exif", distortion=(0.05, -0.1, 0.0, 0.0, 0.0)))
    told = Trace(refined=RefinedViews(first, guessed, np.zeros(3), 30)).parameters()
    assert (told["lens_first"], told["lens_second"]) == ("given", "estimated")
    assert (told["k1_second"], told["k2_second"]) == (0.05, -0.1)
    assert told["focal_first_px"] == round(first.camera.fx, 2)
    assert Trace().parameters() == {}  # of a run that ended early
