"""A stereo rig from photographs of a board: a known rig comes back, and what is no rig is refused."""

import numpy as np
import pytest

from app.core.errors import Failure
from app.vision.board.rig_calibration import RigCalibration, calibrate_rig
from app.vision.intrinsics import Camera
from app.vision.marker_spec import parse_marker
from app.vision.model import Photo
from app.vision.rig import rig_from_mapping, rig_to_json
from tests.unit.vision.synthetic import Pose, look_at
from tests.unit.vision.tag_boards import photograph as take_photograph

BOARD = parse_marker("charuco:8x6:22:16:DICT_4X4_50")
LEFT = Camera(800, 600, fx=650.0, fy=650.0, cx=395.0, cy=303.0)
RIGHT = Camera(700, 525, fx=560.0, fy=560.0, cx=352.0, cy=258.0)
TURN = 0.03  # of the right camera towards the left one, radians
ROTATION = np.array([[np.cos(TURN), 0, np.sin(TURN)], [0, 1, 0], [-np.sin(TURN), 0, np.cos(TURN)]])
TRANSLATION_MM = np.array([-60.0, 1.0, 2.0])
SLANTS = [(60, -90, 0), (50, 0, 20), (55, 120, -30), (80, -90, 90), (45, 60, 10), (50, -150, 45)]
AIMS = [(20, 0), (50, 30), (-30, -30), (40, -30), (-20, 30), (0, 0)]


def right_pose(pose, translation_mm=TRANSLATION_MM):
    return Pose(ROTATION @ pose.rotation, ROTATION @ pose.translation_mm + translation_mm)


@pytest.fixture(scope="module")
def pairs():
    """The first one has its right board partly covered: it calibrates by the points in common."""
    out = []
    for slant, aim in zip(SLANTS, AIMS, strict=True):
        pose = look_at(*slant[:2], 330.0, slant[2], target_mm=(*aim, 0))
        covers_mm = [] if out else [(10.0, -100.0, 100.0, 200.0)]
        right = take_photograph(BOARD, right_pose(pose), camera=RIGHT, covers_mm=covers_mm)
        out.append((take_photograph(BOARD, pose, camera=LEFT), right))
    return out


def calibrated(pairs):
    return calibrate_rig([left for left, _ in pairs], [right for _, right in pairs], BOARD)


def require_true_rig(result):
    assert isinstance(result, RigCalibration), result
    # Six pairs with 0.05 px of noise at 600 px of focal length.
    assert result.rig.baseline_mm == pytest.approx(np.linalg.norm(TRANSLATION_MM), rel=5e-3)
    turned = result.rig.right_from_left @ ROTATION.T
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 0.4  # a principal point some px off turns the camera
    assert result.rig.right.fx == pytest.approx(560.0, rel=5e-3)
    assert (result.rig.right.width, result.rig.right.height) == (700, 525)
    assert result.rms_px < 0.15


def test_known_rig_comes_back_and_its_file_reads_as_it_was_written(pairs):
    result = calibrated(pairs)
    require_true_rig(result)
    assert (result.used, result.rejected) == (tuple(range(6)), ())
    assert rig_from_mapping(rig_to_json(result.rig)) == result.rig


@pytest.mark.slow
def test_pairs_of_two_moments_or_seen_by_one_camera_are_left_out(pairs):
    moved = right_pose(
        look_at(*SLANTS[2][:2], 330.0, SLANTS[2][2], target_mm=(*AIMS[2], 0)),
        TRANSLATION_MM + np.array([0.0, 6.0, 0.0]),
    )
    of_two_moments = pairs[2][0], take_photograph(BOARD, moved, camera=RIGHT)
    half_blank = pairs[0][0], Photo(np.full_like(pairs[0][1].pixels_bgr, 128))
    result = calibrated([*pairs, of_two_moments, half_blank])
    require_true_rig(result)
    assert result.used == tuple(range(6))
    rejected = {each.index: each.failure for each in result.rejected}
    assert rejected.keys() == {6, 7}
    assert rejected[6].code == "calibration_view_poor"
    assert rejected[7].message.startswith("The right photograph:")


@pytest.mark.slow
def test_cameras_that_are_not_fixed_to_each_other_are_no_rig(pairs):
    """The same photographs, each with another one's partner: each camera is calibrated, and no pose fits."""
    left, right = ([pair[side] for pair in pairs] for side in (0, 1))
    for partners in (right[1:] + right[:1], left):  # or one camera twice
        failure = calibrate_rig(left, partners, BOARD)
        assert isinstance(failure, Failure)
        assert failure.code == "rig_not_fixed"
    blank = Photo(np.full_like(right[0].pixels_bgr, 128))
    failure = calibrate_rig(left, [blank] * len(pairs), BOARD)
    assert (failure.code, failure.message.split(":")[0]) == ("calibration_views_insufficient", "The right camera")
    with pytest.raises(ValueError, match="no pairs"):
        calibrate_rig(left, right[1:], BOARD)
