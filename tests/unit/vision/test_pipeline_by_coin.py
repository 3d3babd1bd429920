"""A coin in place of the board: what it tells of distance and tilt, and the ball's volume by it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.core.errors import InvalidInputError
from app.vision.board.round_object import find_round_objects
from app.vision.geometry.ellipse import Ellipse
from app.vision.known_object import KnownObject, parse_scale
from app.vision.marker_spec import MarkerSpec
from app.vision.model import EstimateOptions, Hint, Photo, PhotoPair, View
from app.vision.photograph.photo import ReducedPhoto
from app.vision.pipeline import estimate_meal
from app.vision.precheck import check_pair
from app.vision.views.object_view import place_by_object
from tests.unit.vision.stereo_scene import (
    BALL,
    CAMERA,
    ball_in,
    blank_views,
    covered,
    look_at,
    on_plain_table,
    render,
    view_of,
)

COIN = parse_scale("coin:25.0")
OPTIONS = EstimateOptions(None, CAMERA, known=COIN)
PLACE_MM = np.array([40.0, -75.0, COIN.thick_mm])
SUBPIXELS = 4


@pytest.mark.parametrize("text", ["plain:9x7:11", "coin:eur-1", "coin:25.0"])
def test_board_or_coin_is_read_and_written_alike(text):
    assert str(parse_scale(text)) == text
    assert isinstance(parse_scale(text), KnownObject if text.startswith("coin") else MarkerSpec)


@pytest.mark.parametrize("text", ["coin:", "coin:eur-3", "coin:5.0", "coin:99", "coin:25,0", "coin:25.0 ", "card:id-1"])
def test_what_is_no_coin_is_refused(text):
    with pytest.raises(InvalidInputError) as refused:
        parse_scale(text)
    assert refused.value.code == "marker_invalid"


def circle_px(view, radius_mm=COIN.diameter_mm / 2, z_mm=0.0, count=180):
    """(count, 2) px of a circle about the coin's middle, z_mm from its face."""
    turn = np.arange(count) * 2 * np.pi / count
    ring = PLACE_MM + radius_mm * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(count)]) + [0, 0, z_mm]
    at = ring @ view.rotation.T + view.translation_mm
    return at[:, :2] / at[:, 2:] * view.camera.fx + [view.camera.cx, view.camera.cy]


def with_coin(view: View) -> View:
    """The view without its board, and with a coin: a silver disc with a darker ring and a figure on it."""
    bare = covered(view)
    pixels = bare.photo.pixels_bgr.astype(np.float32)
    for radius_mm, z_mm, grey in (
        (12.5, -COIN.thick_mm, 90),
        (12.5, 0, 205),
        (10.5, 0, 170),
        (10.0, 0, 200),
        (4.0, 0, 160),
    ):
        share = np.zeros([side * SUBPIXELS for side in pixels.shape[:2]], np.uint8)
        places = (circle_px(view, radius_mm, z_mm) + 0.5) * SUBPIXELS - 0.5
        cv2.fillPoly(share, [np.rint(places).astype(np.int32)], 255)
        size = pixels.shape[1::-1]
        alpha = cv2.resize(share, size, interpolation=cv2.INTER_AREA)[..., None].astype(np.float32) / 255
        pixels = pixels * (1 - alpha) + np.float32(grey) * alpha
    noise = np.random.default_rng(3).normal(0, 1, pixels.shape)
    return View(
        Photo(np.clip(pixels + noise, 0, 255).astype(np.uint8)),
        view.camera,
        None,
        view.rotation,
        view.translation_mm,
        0,
    )


@pytest.fixture(scope="module")
def coins(views):
    left, right = (with_coin(view) for view in views)
    return PhotoPair(left.photo, right.photo)


def test_exact_ellipse_gives_distance_and_tilt():
    view = blank_views()[0]
    (x, y), size, degrees = cv2.fitEllipseDirect(circle_px(view).astype(np.float32))
    ellipse = Ellipse(np.array([x, y]), np.array(size) / 2, np.radians(degrees))
    placed = place_by_object(view.photo, CAMERA, ellipse, COIN).first
    apart = np.linalg.norm(view.centre_mm - PLACE_MM * [1, 1, 0])
    assert np.linalg.norm(placed.centre_mm) == pytest.approx(apart, rel=0.01)
    assert placed.rotation[:, 2] @ view.rotation[:, 2] > np.cos(np.radians(2.0))


def test_coin_is_found_where_it_was_drawn(coins, views):
    for photo, view in zip(coins.both, views, strict=True):
        ellipse = find_round_objects(photo, CAMERA, COIN, "left")[0].ellipse
        drawn = circle_px(view)
        assert np.linalg.norm(ellipse.centre - drawn.mean(axis=0)) < 2.0
        area = cv2.contourArea(drawn.astype(np.float32))
        assert ellipse.radius == pytest.approx(np.sqrt(area / np.pi), rel=0.04)


def ball_of(estimate):
    assert estimate.failure is None, estimate.failure
    item = max(estimate.items, key=lambda item: (item.hint is not None, item.volume_ml or 0))
    low, high = item.volume_interval_ml
    assert low < BALL.volume_ml < high
    assert "scale_from_object" in item.flags
    return item


def test_two_photographs_of_a_coin_give_the_balls_volume(coins):
    estimate = estimate_meal(coins, OPTIONS)
    assert estimate.parameters["scale_source"] == "object"
    item = ball_of(estimate)
    assert item.volume_ml == pytest.approx(BALL.volume_ml, rel=0.12)
    assert not {"camera_unknown", "single_view"} & set(item.flags)
    unknown = ball_of(estimate_meal(coins, EstimateOptions(None, known=COIN)))
    assert "camera_unknown" in unknown.flags


def test_left_photograph_is_measured_alone_where_the_right_one_is_none_of_the_scene(coins, views):
    x, y, z = views[0].rotation @ [*BALL.centre_mm, BALL.radius_mm] + views[0].translation_mm
    at_ball = Hint(point=(CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy))
    left, other = on_plain_table(coins.left), Photo(np.full_like(coins.left.pixels_bgr, 128))
    for right in (None, other):
        item = ball_of(estimate_meal(PhotoPair(left, right), replace(OPTIONS, hints=(at_ball,))))
        assert "single_view" in item.flags
        assert item.volume_ml == pytest.approx(BALL.volume_ml, rel=0.35)


@pytest.fixture(scope="module")
def from_above_and_side():
    """The ball, coloured unlike the table, from above with the coin, and from the side without it."""
    shown = []
    for centre_mm in ((90.0, -60.0, 420.0), (40.0, -330.0, 95.0)):
        pose = look_at(centre_mm, (90.0, 0.0, 20.0))
        view = covered(view_of(np.clip(render(pose, BALL, 0), 0, 255).astype(np.uint8), pose))
        ball = ball_in(view)
        pixels = view.photo.pixels_bgr.copy()
        pixels[ball] = np.clip(pixels[ball] * np.array([0.3, 0.5, 1.2]), 0, 255)
        shown.append(replace(view, photo=Photo(pixels)))
    above, side = shown
    y, x = (float(places.mean()) for places in np.nonzero(ball_in(above)))
    return PhotoPair(with_coin(above).photo, side.photo), replace(OPTIONS, hints=(Hint(point=(x, y)),))


def test_photograph_from_the_side_tells_the_height(from_above_and_side):
    pair, options = from_above_and_side
    item = ball_of(estimate_meal(pair, options))
    assert "view_from_side" in item.flags
    assert "single_view" not in item.flags
    assert item.volume_ml == pytest.approx(BALL.volume_ml, rel=0.06)


def test_without_a_coin_nothing_is_measured(views):
    bare = [covered(view).photo for view in views]
    assert estimate_meal(PhotoPair(*bare), OPTIONS).failure.code == "marker_not_found"


def test_coin_is_checked_before_sending(coins, views):
    bare = ReducedPhoto(covered(views[0]).photo, 1)
    left, right = (ReducedPhoto(photo, 1) for photo in coins.both)
    assert check_pair(left, right, COIN, None).is_ok
    problems = check_pair(left, bare, COIN, None).problems
    assert [(each.code, each.severity, each.side) for each in problems] == [("marker_not_found", "stop", "right")]
