"""`tada estimate` with one photograph and a depth map: files by name, and what is refused."""

import json

import cv2
import numpy as np
import pytest

from app.core.errors import InvalidInputError
from app.estimates.estimate_files import estimate_files, read_options
from app.estimates.read_photographs import DepthFiles
from app.estimates.run_estimate import run_estimate
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, rendered_views


@pytest.fixture
def files(tmp_path):
    photo = tmp_path / "v1.png"
    cv2.imwrite(str(photo), rendered_views(Ball((115.0, 15.0), 33.0))[0].photo.pixels_bgr)
    camera = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5}
    (tmp_path / "depth.json").write_text(json.dumps(camera))
    cv2.imwrite(str(tmp_path / "depth.png"), np.zeros((48, 64), np.uint16))
    return tmp_path


def estimated(files, depths, camera="depth.json", confidences=()):
    options = read_options(marker=str(SPEC), camera=None, method="shape", hints=[], has_depth=bool(depths))
    depth_camera = files / camera if camera else None
    return estimate_files(
        [files / "v1.png"],
        options,
        max_pixels=10**8,
        debug=None,
        on_stage=None,
        depths=depths,
        depth_camera=depth_camera,
        confidences=confidences,
    )


def test_one_photograph_is_measured(files):
    answer = estimated(files, [])
    assert answer["camera"]["width"] == CAMERA.width
    assert answer["camera_right"] is None
    assert answer["failure"] is None or answer["failure"]["code"] == "no_food_found"


@pytest.mark.parametrize("view", ["v1", "left"])
def test_bad_depth_map_fails_with_its_code(files, view):
    assert estimated(files, [f"{view}={files / 'depth.png'}"])["failure"]["code"] == "depth_empty"


@pytest.mark.parametrize(
    ("depths", "camera"), [(["right=depth.png"], "depth.json"), (["v1"], "depth.json"), (["v1=depth.png"], None)]
)
def test_depth_of_no_photograph_or_without_a_camera_is_refused(files, depths, camera):
    with pytest.raises(InvalidInputError):
        estimated(files, depths, camera)


def test_depth_leaves_the_marker_out_unless_one_is_named():
    assert read_options(marker=None, camera=None, method="shape", hints=[], has_depth=True).marker is None
    assert read_options(marker=None, camera=None, method="shape", hints=[]).marker is not None


def test_confidence_map_is_read_beside_its_depth_map(files):
    cv2.imwrite(str(files / "depth.png"), np.full((48, 64), 5000, np.uint16))
    cv2.imwrite(str(files / "low.png"), np.zeros((48, 64), np.uint8))
    depths = [f"left={files / 'depth.png'}"]
    assert estimated(files, depths, confidences=[f"v1={files / 'low.png'}"])["failure"]["code"] == "depth_empty"


def test_confidence_map_without_its_depth_map_is_refused(files):
    with pytest.raises(InvalidInputError, match="--depth-confidence"):
        estimated(files, [], confidences=[f"left={files / 'depth.png'}"])


def test_map_that_cannot_be_used_is_left_out_where_a_marker_gives_the_scale(files):
    options = read_options(marker=str(SPEC), camera=None, method="shape", hints=[], has_depth=True)
    camera = json.loads((files / "depth.json").read_text())
    turned = camera | {"width": 48, "height": 64, "cx": 23.5, "cy": 31.5}
    for of_map, code in ((camera, "depth_empty"), (turned, "depth_mismatch")):
        depths = {"left": DepthFiles(files / "depth.png", of_map)}
        answers = [
            run_estimate(
                {"left": files / "v1.png"},
                options,
                max_pixels=10**8,
                on_stage=lambda _: None,
                want_artefacts=False,
                depths=depths,
                is_depth_needed=is_depth_needed,
            )[0]
            for is_depth_needed in (True, False)
        ]
        assert answers[0].failure.code == code
        assert answers[1].failure is None
        assert all("depth_ignored" in item.flags for item in answers[1].items)
        assert len(answers[1].items) > 0
