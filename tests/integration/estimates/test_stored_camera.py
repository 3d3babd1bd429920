"""A stored calibration on a rendered pair: measured from board photographs, used, and no worse than EXIF."""

from dataclasses import replace

import pytest

from app.estimates.camera_choice import median_camera
from app.vision.board.calibration import calibrate
from app.vision.model import EstimateOptions
from app.vision.pipeline import estimate_meal
from tests.support.scenes import load_scene
from tests.unit.vision.synthetic import look_at, render_board

SLANTS = [(60, -90, 0), (50, 0, 20), (55, 120, -30), (80, -90, 90), (45, 60, 10), (50, -150, 45)]
AIMS = [(0, 0), (45, 30), (-45, -30), (35, -35), (-45, 35), (0, 0)]


def error(estimate, truth):
    assert estimate.failure is None
    return abs(sum(item.volume_ml for item in estimate.items) / sum(one["volume_ml"] for one in truth["items"]) - 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["apple-1", "kiwi-1"])
def test_meal_measured_with_its_phones_calibration_is_no_worse_than_by_exif(shared_data, name):
    """Board photographs of the scene's own camera at a quarter of its size; the calibration is scaled to the meal's."""
    scene = load_scene(shared_data, name)
    true = scene.camera
    small = replace(
        true,
        width=true.width // 4,
        height=true.height // 4,
        fx=true.fx / 4,
        fy=true.fy / 4,
        cx=(true.cx + 0.5) / 4 - 0.5,
        cy=(true.cy + 0.5) / 4 - 0.5,
    )
    boards = [
        render_board(scene.spec, small, look_at(*slant[:2], 230.0, slant[2], target_mm=(*aim, 0)))
        for slant, aim in zip(SLANTS, AIMS, strict=True)
    ]
    measured = calibrate(boards, scene.spec)
    assert measured.camera.fx == pytest.approx(small.fx, rel=5e-3)
    stored = median_camera([measured.camera], (true.width, true.height))
    by_exif = scene.estimate_by_exif(scene.pair)
    by_stored = estimate_meal(scene.pair, EstimateOptions(scene.spec, stored))
    assert by_stored.views[0].camera.source == "given"
    assert error(by_stored, scene.truth) < max(0.05, error(by_exif, scene.truth) + 0.02)
