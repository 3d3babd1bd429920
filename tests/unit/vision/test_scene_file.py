"""scene.json of a rendered ball, whose place, size and outline in both photographs are known."""

import base64
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.vision.figures import draw_artefacts
from app.vision.geometry.mesh import enclosed_mm3
from app.vision.model import EstimateOptions, ItemEstimate, Photo, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.scene.segmentation import Region
from app.vision.scene_file import MAX_BYTES, write_scene
from app.vision.shape.measure import MeasuredItem
from tests.unit.vision.meshes import assert_watertight
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, rendered_views

BALL = Ball((115.0, 15.0), 33.0)
MIDDLE = np.array([*BALL.centre_mm, BALL.radius_mm])
TYPES = {"int16": "<i2", "uint16": "<u2", "uint8": "u1"}


def scene_of(pair, method="shape"):
    """The scene that a run leaves, and the run's answer."""
    estimate = estimate_meal(pair, EstimateOptions(SPEC, CAMERA, method), want_artefacts=True)
    (content,) = [each.content for each in estimate.artefacts if each.name == "scene.json"]
    return json.loads(content), estimate


def pair_of(views):
    return PhotoPair(views[0].photo, views[1].photo)


@pytest.fixture(scope="module")
def views():
    return rendered_views(BALL)


@pytest.fixture(scope="module")
def found(views):
    """The scene, the run's answer, and what the scene was drawn of."""
    drawn = []

    def draw_and_keep(*arguments):
        drawn.append(arguments)
        return draw_artefacts(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.vision.pipeline.draw_artefacts", draw_and_keep)
        scene, estimate = scene_of(pair_of(views))
    return scene, estimate, drawn[0]


@pytest.fixture(scope="module")
def scene(found):
    return found[0]


def unpack(packed):
    """As docs/volume.md says."""
    values = np.frombuffer(base64.b64decode(packed["base64"]), TYPES[packed["type"]]).reshape(packed["shape"])
    return values if "scale" not in packed else values * np.array(packed["scale"]) + np.array(packed["offset"])


def mesh_of(scene, item):
    faces = unpack(scene["topologies"][item["shape"]["topology"]]).astype(np.int64)
    return unpack(item["shape"]["vertices"]), faces


def ball_in(view):
    """(H, W) where a photograph shows the ball."""
    x, y = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, np.ones(x.shape)], -1)
    middle = view.rotation @ MIDDLE + view.translation_mm
    along = rays @ middle
    return along**2 > (rays**2).sum(-1) * (middle @ middle - BALL.radius_mm**2)


def overlap(rings, mask):
    drawn = np.zeros(mask.shape, np.uint8)
    cv2.fillPoly(drawn, [np.rint(np.array(ring)).astype(np.int32) for ring in rings], 1)
    return np.count_nonzero((drawn > 0) & mask) / np.count_nonzero((drawn > 0) | mask)


def test_shape_is_closed_and_holds_the_volume_that_the_file_tells(found):
    scene, estimate, _ = found
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


def test_table_lies_at_zero_and_points_are_few(scene):
    points = unpack(scene["points"]["positions"])
    table = points[sum(item["points"]["count"] for item in scene["items"]) :]
    # Some in the ball's shadow lie across its outline.
    assert abs(np.median(table[:, 2])) < 0.3
    assert 20_000 < len(points) <= 40_000
    assert len(json.dumps(scene)) < MAX_BYTES


def test_outline_in_the_right_photograph_is_the_balls(scene, views):
    (item,) = scene["items"]
    assert item["right_rings_from"] == "shape"
    assert overlap(item["right_rings_px"], ball_in(views[1])) > 0.93


def test_swapped_photographs_have_the_outline_that_was_measured(views):
    swapped, _ = scene_of(pair_of(views[::-1]))
    (item,) = swapped["items"]
    assert item["right_rings_from"] == "mask"
    assert overlap(item["right_rings_px"], ball_in(views[0])) > 0.93


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


def test_the_papers_stack_of_slices_is_closed_and_holds_exactly_the_volume(views):
    scene, _ = scene_of(pair_of(views), "paper")
    (item,) = scene["items"]
    vertices, faces = mesh_of(scene, item)
    assert_watertight(faces)
    assert enclosed_mm3(vertices, faces) / 1000 == pytest.approx(item["volume_ml"], rel=1e-4)
    assert overlap(item["right_rings_px"], ball_in(views[1])) > 0.85


def test_table_without_food_has_its_points_and_no_items():
    scene, estimate = scene_of(pair_of(rendered_views(None)))
    assert estimate.failure.code == "no_food_found"
    assert scene["items"] == []
    assert scene["points"]["positions"]["shape"][0] > 10_000


def test_marker_in_one_photograph_only_is_all_that_is_told(views):
    left = views[0].photo
    scene, _ = scene_of(PhotoPair(left, Photo(np.full_like(left.pixels_bgr, 128))))
    assert set(scene) == {"version", "units", "photographs", "board"}
    assert set(scene["photographs"]["left"]) == {"width", "height", "marker_corners_px"}
    assert set(scene["photographs"]["right"]) == {"width", "height"}


def test_no_marker_no_scene(views):
    nothing = Photo(np.full_like(views[0].photo.pixels_bgr, 128))
    estimate = estimate_meal(PhotoPair(nothing, nothing), EstimateOptions(SPEC, CAMERA), want_artefacts=True)
    assert estimate.artefacts == []


@pytest.fixture
def run(found):
    """Arguments of write_scene for the run: (trace, pair, items). The trace is a copy that a test may change."""
    trace, pair, items = found[2]
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


def test_scene_without_board_and_food_has_the_points_around_its_origin(run):
    trace, pair, _ = run
    trace.items, trace.scale = [], "rig"
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
