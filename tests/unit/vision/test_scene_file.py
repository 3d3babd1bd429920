"""scene.json of a rendered ball, whose place, size and outline in both photographs are known."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3
from app.vision.model import ItemEstimate
from app.vision.scene.segmentation import Region
from app.vision.scene_file import MAX_BYTES, write_scene
from app.vision.solids.measured_item import MeasuredItem
from tests.unit.vision.meshes import assert_watertight
from tests.unit.vision.stereo_scene import BALL, CAMERA, ball_in, overlap

MIDDLE = np.array([*BALL.centre_mm, BALL.radius_mm])
TYPES = {"int16": "<i2", "uint16": "<u2", "uint8": "u1"}


@pytest.fixture(scope="module")
def scene(estimate, scene_of):
    return scene_of(estimate)


def unpack(packed):
    """As docs/volume.md says."""
    values = np.frombuffer(base64.b64decode(packed["base64"]), TYPES[packed["type"]]).reshape(packed["shape"])
    return values if "scale" not in packed else values * np.array(packed["scale"]) + np.array(packed["offset"])


def mesh_of(scene, item):
    faces = unpack(scene["topologies"][item["shape"]["topology"]]).astype(np.int64)
    return unpack(item["shape"]["vertices"]), faces


def test_shape_is_closed_and_holds_the_volume_that_the_file_tells(scene, estimate):
    (item,) = scene["items"]
    vertices, faces = mesh_of(scene, item)
    assert_watertight(faces)
    held_ml = enclosed_mm3(vertices, faces) / 1000
    assert held_ml == pytest.approx(item["mesh_volume_ml"], abs=0.001)
    # The answer is averaged over families of form, the shape is the likeliest one's.
    assert held_ml == pytest.approx(item["volume_ml"], rel=0.05)
    assert item["volume_ml"] == pytest.approx(estimate.items[0].volume_ml, abs=0.001)
    assert item["volume_interval_ml"] == pytest.approx(estimate.items[0].volume_interval_ml, abs=0.001)


def test_shape_slices_and_points_lie_on_the_ball(scene):
    (item,) = scene["items"]
    vertices, _ = mesh_of(scene, item)
    off = np.linalg.norm(vertices - MIDDLE, axis=1) - BALL.radius_mm
    assert np.percentile(np.abs(off), 90) < 3.0  # of 33 mm, the unseen lower third among them
    assert item["size_mm"] == pytest.approx({"width": 66, "depth": 66, "height": 66}, abs=4.0)
    for each in item["slices"][4:-4]:
        z = (each["low_mm"] + each["high_mm"]) / 2 - BALL.radius_mm
        assert np.sqrt(np.prod(each["half_axes_mm"])) == pytest.approx(np.sqrt(BALL.radius_mm**2 - z**2), abs=3.0)
        assert each["centre_mm"] == pytest.approx(BALL.centre_mm, abs=3.0)
    start, count = item["points"]["start"], item["points"]["count"]
    own = unpack(scene["points"]["positions"])[start : start + count]
    assert count > 2000
    assert abs(np.median(np.linalg.norm(own - MIDDLE, axis=1) - BALL.radius_mm)) < 0.5
    red, green, blue = np.median(unpack(scene["points"]["colours"])[start : start + count], axis=0)
    assert red > green > blue  # the ball is orange


def test_table_lies_at_zero_points_are_few_and_the_outline_in_the_right_photograph_is_the_balls(scene, views):
    points = unpack(scene["points"]["positions"])
    table = points[sum(item["points"]["count"] for item in scene["items"]) :]
    # Some in the ball's shadow lie across its outline.
    assert abs(np.median(table[:, 2])) < 0.3
    assert 20_000 < len(points) <= 40_000
    assert len(json.dumps(scene)) < MAX_BYTES
    (item,) = scene["items"]
    assert item["right_rings_from"] == "shape"
    assert overlap(item["right_rings_px"], ball_in(views[1])) > 0.93


def test_board_has_its_size_and_is_where_the_cameras_see_it(scene, views):
    board = scene["board"]
    assert (board["columns"], board["rows"], board["square_mm"], board["marker"]) == (9, 7, 11.0, "plain:9x7:11")
    assert board["square_colours"][0] == [20, 20, 20]
    for name, view in zip(("left", "right"), views, strict=True):
        photograph = scene["photographs"][name]
        assert (photograph["width"], photograph["height"]) == (CAMERA.width, CAMERA.height)
        assert np.allclose(photograph["marker_corners_px"], view.marker.corners_px, atol=0.5)
        camera = photograph["camera"]
        corner = np.array([(1 - 9 / 2) * 11.0, (7 / 2 - 1) * 11.0, 0.0])  # the first, CONVENTIONS.md
        x, y, z = np.array(camera["rotation"]) @ corner + camera["translation_mm"]
        seen = [camera["fx"] * x / z + camera["cx"], camera["fy"] * y / z + camera["cy"]]
        assert seen == pytest.approx(photograph["marker_corners_px"][0], abs=0.5)
        assert camera["centre_mm"] == pytest.approx(view.centre_mm, abs=3.0)


@pytest.fixture
def run(ball_run):
    """Arguments of write_scene for the run: (trace, pair, items). The trace is a copy that a test may change."""
    trace, pair, items = ball_run[1]
    return replace(trace), pair, items


def test_board_that_gave_no_scale_is_not_in_the_scene_but_the_points_are(run):
    trace, pair, items = run
    trace.markers, trace.scale = (None, trace.markers[1]), "depth"  # whose table frame is not the board's
    scene = json.loads(write_scene(trace, pair, items))
    assert "board" not in scene
    assert "marker_corners_px" in scene["photographs"]["right"]
    points = unpack(scene["points"]["positions"])
    assert len(points) > 20_000
    assert np.abs(points[:, :2] - BALL.centre_mm).max() < BALL.radius_mm + 65.0  # and no longer as far as the board
    trace.items, trace.scale = [], "rig"  # without food, the points around the origin
    points = unpack(json.loads(write_scene(trace, pair, []))["points"]["positions"])
    assert len(points) > 10_000
    assert 200.0 < np.abs(points[:, :2]).max() < 251.0


def test_content_of_a_bowl_has_the_outline_that_is_seen_and_without_a_measure_no_shape(run, views):
    """The ball is taken for the content of an opaque bowl."""
    trace, pair, items = run
    (measured,) = trace.items
    trace.items = [replace(measured, flags=("inside_guessed",))]
    (item,) = json.loads(write_scene(trace, pair, items))["items"]
    assert item["shape"]
    assert item["right_rings_from"] == "mask"  # a bowl's wall hides the shape below its top
    trace.items = [MeasuredItem(Region(measured.region.mask), measured.points_table, 0.0, None, ("not_measurable",))]
    unknown = ItemEstimate(items[0].rings, None, None, {}, flags=("not_measurable",))
    (item,) = json.loads(write_scene(trace, pair, [unknown]))["items"]
    assert not {"shape", "slices", "size_mm", "mesh_volume_ml"} & set(item)
    assert (item["volume_ml"], item["volume_interval_ml"], item["flags"]) == (None, None, ["not_measurable"])
    assert item["right_rings_from"] == "mask"
    assert overlap(item["right_rings_px"], ball_in(views[1])) > 0.8
