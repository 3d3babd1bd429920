"""`tada estimate` with one photograph and a depth map: files by name, and what is refused."""

import json

import cv2
import numpy as np
import pytest

from app.core.errors import InvalidInputError
from app.meals.estimate.estimate_files import estimate_files, read_options
from app.meals.estimate.run_estimate import DepthFiles, run_estimate
from tests.unit.vision.stereo_scene import BALL, SPEC, rendered_views


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("depth")
    cv2.imwrite(str(folder / "v1.png"), rendered_views(BALL)[0].photo.pixels_bgr)
    camera = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5}
    (folder / "depth.json").write_text(json.dumps(camera))
    cv2.imwrite(str(folder / "depth.png"), np.zeros((48, 64), np.uint16))
    cv2.imwrite(str(folder / "far.png"), np.full((48, 64), 5000, np.uint16))
    cv2.imwrite(str(folder / "low.png"), np.zeros((48, 64), np.uint8))
    return folder


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


@pytest.mark.parametrize(
    ("depth", "confidences"), [("v1=depth.png", []), ("left=depth.png", []), ("left=far.png", ["v1=low.png"])]
)
def test_bad_depth_map_or_its_confidence_fails_with_its_code(files, depth, confidences, monkeypatch):
    monkeypatch.chdir(files)
    assert estimated(files, [depth], confidences=confidences)["failure"]["code"] == "depth_empty"


@pytest.mark.parametrize(
    ("depths", "camera", "confidences"),
    [
        (["right=depth.png"], "depth.json", []),
        (["v1"], "depth.json", []),
        (["v1=depth.png"], None, []),
        ([], "depth.json", ["left=depth.png"]),
    ],
)
def test_depth_of_no_photograph_without_a_camera_or_confidence_without_depth_is_refused(
    files, depths, camera, confidences
):
    with pytest.raises(InvalidInputError, match="--depth-confidence" if confidences else None):
        estimated(files, depths, camera, confidences)


def test_depth_leaves_the_marker_out_unless_one_is_named():
    assert read_options(marker=None, camera=None, method="shape", hints=[], has_depth=True).marker is None
    assert read_options(marker=None, camera=None, method="shape", hints=[]).marker is not None


def estimated_beside_the_marker(files, camera, *, is_depth_needed):
    options = read_options(marker=str(SPEC), camera=None, method="shape", hints=[], has_depth=True)
    return run_estimate(
        {"left": files / "v1.png"},
        options,
        max_pixels=10**8,
        on_stage=lambda _: None,
        want_artefacts=False,
        depths={"left": DepthFiles(files / "depth.png", camera)},
        is_depth_needed=is_depth_needed,
    )[0]


@pytest.mark.slow
def test_map_that_cannot_be_used_is_left_out_where_a_marker_gives_the_scale(files):
    camera = json.loads((files / "depth.json").read_text())
    turned = camera | {"width": 48, "height": 64, "cx": 23.5, "cy": 31.5}
    for of_map, code in ((camera, "depth_empty"), (turned, "depth_mismatch")):
        assert estimated_beside_the_marker(files, of_map, is_depth_needed=True).failure.code == code
    answer = estimated_beside_the_marker(files, turned, is_depth_needed=False)
    assert answer.failure is None
    assert len(answer.items) > 0
    assert all("depth_ignored" in item.flags for item in answer.items)
