"""A HEIC photograph whose file holds a depth map: it joins, is left out with a flag, and gives way to a sent one."""

import cv2
import numpy as np
import pytest

from app.meals.estimate.run_estimate import DepthFiles, run_estimate
from app.vision.model import EstimateOptions
from tests.support.heic_files import MATTE, heic_with_map, packet, quantised
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, on_plain_table, rendered_views, true_depth

pytestmark = pytest.mark.slow  # a HEIC of a whole photograph takes seconds to write

SIZE = (256, 192)
TOLERANCE = 0.12  # as of a map that is sent beside the photograph


@pytest.fixture(scope="module")
def rgb():
    return cv2.cvtColor(on_plain_table(rendered_views(BALL)[0].photo).pixels_bgr, cv2.COLOR_BGR2RGB)


@pytest.fixture(scope="module")
def per_m():
    """The true disparity, 1/m, with the noise of a phone's sensor."""
    view = rendered_views(BALL)[0]
    centre = tuple((side - 1) / 2 for side in SIZE)
    depth = true_depth(view.rotation, view.centre_mm, CAMERA.fx * SIZE[0] / CAMERA.width, centre, SIZE[::-1], BALL)
    return 1000 / depth * (1 + 0.01 * np.random.default_rng(0).standard_normal(depth.shape))


def items_of(folder, data, right=None, **options):
    files = {"left": data} | ({"right": right} if right is not None else {})
    for side, content in files.items():
        (folder / side).write_bytes(content)
    answer, _ = run_estimate(
        {side: folder / side for side in files},
        EstimateOptions(SPEC, CAMERA),
        max_pixels=10**8,
        on_stage=lambda _: None,
        want_artefacts=False,
        is_depth_needed=False,
        **options,
    )
    assert answer.failure is None
    return answer.items


@pytest.mark.parametrize("accuracy", ["relative", "absolute"])
def test_depth_inside_the_file_measures_the_ball(rgb, per_m, accuracy, tmp_path):
    levels, low, high = quantised(per_m if accuracy == "absolute" else 0.62 * per_m - 0.4)
    [item] = items_of(tmp_path, heic_with_map(rgb, levels, packet(low, high, accuracy=accuracy)))
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert item.volume_interval_ml[0] < BALL.volume_ml < item.volume_interval_ml[1]
    assert "depth_ignored" not in item.flags


def test_map_of_no_use_is_left_out_with_a_flag_and_a_matte_without_one(rgb, per_m, tmp_path):
    levels = quantised(per_m)[0]
    broken = items_of(tmp_path, heic_with_map(rgb, levels, packet("nan", 1)))
    matte = items_of(tmp_path, heic_with_map(rgb, levels, packet(0, 1, native="L008"), urn=MATTE))
    assert [item.volume_ml for item in broken] == [item.volume_ml for item in matte]
    assert all("depth_ignored" in item.flags for item in broken)
    assert not any("depth_ignored" in item.flags for item in matte)


def test_map_that_is_sent_takes_the_place_of_the_one_inside(rgb, per_m, tmp_path):
    levels, low, high = quantised(per_m)
    cv2.imwrite(str(tmp_path / "empty.png"), np.zeros(SIZE[::-1], np.uint16))
    camera = {"width": SIZE[0], "height": SIZE[1], "fx": 245.0, "fy": 245.0, "cx": 127.5, "cy": 95.5}
    data = heic_with_map(rgb, levels, packet(low, high, accuracy="absolute"))
    items = items_of(tmp_path, data, depths={"left": DepthFiles(tmp_path / "empty.png", camera)})
    assert all("depth_ignored" in item.flags for item in items)  # the sent one is empty
    assert len(items) > 0


def test_map_inside_is_not_read_of_a_pair(rgb, per_m, tmp_path):
    levels, low, high = quantised(3.0 * per_m)  # which contradicts the photographs
    right = cv2.imencode(".png", rendered_views(BALL)[1].photo.pixels_bgr)[1].tobytes()
    [item] = items_of(tmp_path, heic_with_map(rgb, levels, packet(low, high, accuracy="absolute")), right)
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert not any("depth" in flag for flag in item.flags)
