"""A rendered meal with known truth: a textured ball on a patterned table beside the board, seen by two cameras.

Rays are cast pixel by pixel, so that what the tests know of it is exact: poses, depths, the ball's place and volume.
"""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np

from app.vision.board.pose import board_points
from app.vision.board.print_layout import sheet_half_mm
from app.vision.intrinsics import Camera
from app.vision.marker_spec import PlainBoard
from app.vision.model import Float64Array, ImageArray, MarkerObservation, Photo, View

SPEC = PlainBoard(9, 7, 11.0)
CAMERA = Camera(1200, 900, 1150.0, 1150.0, 599.5, 449.5)
OVERSAMPLING = 2
STRIP_ROWS = 30  # rendered at a time: their rays fit into the processor's cache


@dataclass(frozen=True)
class Ball:
    """Its lowest point touches the table, z = 0."""

    centre_mm: tuple[float, float]
    radius_mm: float

    @property
    def volume_ml(self) -> float:
        return 4 / 3 * np.pi * self.radius_mm**3 / 1000


BALL = Ball((115.0, 15.0), 33.0)


def look_at(centre_mm, target_mm, roll_deg=0.0):
    """Rotation (3, 3) and translation (3,), table to camera."""
    centre, target = np.asarray(centre_mm, float), np.asarray(target_mm, float)
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    roll = np.radians(roll_deg)
    rotation = np.stack(
        [np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, forward]
    )
    return rotation, -rotation @ centre


def view_of(pixels: ImageArray, pose, camera: Camera = CAMERA) -> View:
    rotation, translation = pose
    points = board_points(SPEC) @ rotation.T + translation
    corners = points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return View(Photo(pixels), camera, MarkerObservation(SPEC, corners), rotation, translation, 0.0)


def blank_views(baseline_mm=60.0, roll_deg=0.0, height_mm=330.0) -> tuple[View, View]:
    """Two views of nothing, for geometry alone."""
    pixels = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    poses = [
        look_at((60.0 + side * baseline_mm / 2, -260.0, height_mm), (60.0, 0.0, 10.0), roll_deg) for side in (-1, 1)
    ]
    return view_of(pixels, poses[0]), view_of(pixels, poses[1])


@cache
def rendered_views(ball: Ball | None, roll_deg=0.0, seed=0) -> tuple[View, View]:
    """The same two cameras, with a picture of the board, the table and the ball. The pictures are shared: read-only."""
    out = []
    for index, view in enumerate(blank_views(roll_deg=roll_deg)):
        pixels = render((view.rotation, view.translation_mm), ball, seed)
        noisy = pixels + np.random.default_rng((seed, index)).normal(0.0, 1.0, pixels.shape)
        picture = np.clip(noisy + 0.5, 0, 255).astype(np.uint8)
        picture.flags.writeable = False
        out.append(view_of(picture, (view.rotation, view.translation_mm)))
    return out[0], out[1]


def render(pose, ball: Ball | None, seed: int, camera: Camera = CAMERA) -> Float64Array:
    """(H, W, 3) grey levels, BGR."""
    strips = []
    for top in range(0, camera.height, STRIP_ROWS):
        rows = range(top, min(top + STRIP_ROWS, camera.height))
        colour = _colours(pose, ball, seed, camera, rows)
        strips.append(cv2.resize(colour, (camera.width, len(rows)), interpolation=cv2.INTER_AREA))
    return np.vstack(strips)


def _colours(pose, ball, seed, camera, pixel_rows: range):
    """(k rows, k W, 3) what the rays of these rows of pixels meet, OVERSAMPLING = k of them a pixel in x and in y."""
    rotation, translation = pose
    centre = -rotation.T @ translation
    k = OVERSAMPLING
    columns, rows = np.arange(camera.width * k), np.arange(pixel_rows.start * k, pixel_rows.stop * k)[:, None]
    x = ((columns + 0.5) / k - 0.5 - camera.cx) / camera.fx
    y = ((rows + 0.5) / k - 0.5 - camera.cy) / camera.fy
    ray = [rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] for axis in range(3)]
    reach = -centre[2] / np.minimum(ray[2], -1e-6)
    colour = _table_colour(centre[0] + reach * ray[0], centre[1] + reach * ray[1], seed)
    if ball is not None:
        from_middle = centre - [*ball.centre_mm, ball.radius_mm]
        a = ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2
        b = ray[0] * from_middle[0] + ray[1] * from_middle[1] + ray[2] * from_middle[2]
        root = b * b - a * (from_middle @ from_middle - ball.radius_mm**2)
        hit = np.flatnonzero(root > 0)
        near = (-b.take(hit) - np.sqrt(root.take(hit))) / a.take(hit)
        offsets = np.stack([from_middle[axis] + near * ray[axis].take(hit) for axis in range(3)], -1)
        colour[hit] = _ball_colour(offsets, ball.radius_mm, seed)
    return colour.reshape(*reach.shape, 3)


def _noise(rng, cells, shape):
    return cv2.resize(rng.uniform(-1, 1, (cells, cells)), shape, interpolation=cv2.INTER_CUBIC)


@cache
def _table_texture(seed):
    """(1024, 1024, 3) grey levels, BGR."""
    rng = np.random.default_rng(seed + 100)
    texture = sum(_noise(rng, cells, (1024, 1024)) / 2**n for n, cells in enumerate((32, 128, 512)))
    grey = 120.0 + 25.0 * texture
    return np.stack([grey * 0.8, grey, grey * 1.1], -1)


def _table_colour(x, y, seed):
    """Return the grey levels, (n, 3), of the points of a grid; x, y: mm, of n values each."""
    texture = _table_texture(seed)
    size = len(texture)
    texel = np.floor(y * 1.6).astype(int) % size * size + np.floor(x * 1.6).astype(int) % size
    colour = texture.reshape(-1, 3).take(texel.ravel(), axis=0)
    side = SPEC.square_mm
    column = np.floor(x / side + SPEC.columns / 2)
    row = np.floor(SPEC.rows / 2 - y / side)
    sheet = (column >= -1) & (column <= SPEC.columns) & (row >= -1) & (row <= SPEC.rows)
    on_board = (column >= 0) & (column < SPEC.columns) & (row >= 0) & (row < SPEC.rows)
    colour[np.flatnonzero(sheet)] = 235.0
    colour[np.flatnonzero(on_board & ((row + column) % 2 == 0))] = 25.0
    return colour


@cache
def _ball_texture(seed):
    """(512, 512, 3) grey levels, BGR."""
    rng = np.random.default_rng(seed + 200)
    texture = sum(_noise(rng, cells, (512, 512)) / 2**n for n, cells in enumerate((24, 96, 256)))
    grey = 110.0 + 45.0 * texture
    return np.stack([grey * 0.2, grey * 0.6, grey * 1.4], -1)


def _ball_colour(offsets, radius, seed):
    u = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2 * np.pi) + 0.5
    v = np.arccos(np.clip(offsets[:, 2] / radius, -1, 1)) / np.pi
    return _ball_texture(seed)[(v * 511).astype(int), (u * 511).astype(int)]


def true_depth(pair_rotation, pair_centre, focal, centre_px, shape, ball: Ball | None):
    """(H, W) depth along the rectified axis of table and ball, mm."""
    columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    rays = (
        np.stack([(columns - centre_px[0]) / focal, (rows - centre_px[1]) / focal, np.ones(shape)], -1) @ pair_rotation
    )
    depth = -pair_centre[2] / np.minimum(rays[..., 2], -1e-6)
    if ball is not None:
        middle = np.array([*ball.centre_mm, ball.radius_mm])
        a, b = (rays**2).sum(-1), rays @ (pair_centre - middle)
        root = b * b - a * ((pair_centre - middle) @ (pair_centre - middle) - ball.radius_mm**2)
        hit = root > 0
        depth[hit] = (-b[hit] - np.sqrt(root[hit])) / a[hit]
    return depth


def true_parallax(pair, ball: Ball | None):
    """(H, W) float32 parallax on a rectified pair's grid of table and ball, px."""
    depth = true_depth(pair.rotation, pair.first_centre_mm, pair.focal_px, pair.centre_px, pair.shape, ball)
    return pair.parallax_from_disparity((pair.focal_px * pair.baseline_mm / depth).astype(np.float32))


def ball_in(view: View):
    """(H, W) where a photograph shows BALL."""
    camera = view.camera
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(x.shape)], -1)
    middle = view.rotation @ [*BALL.centre_mm, BALL.radius_mm] + view.translation_mm
    return (rays @ middle) ** 2 > (rays**2).sum(-1) * (middle @ middle - BALL.radius_mm**2)


def overlap(rings, mask) -> float:
    """Intersection over union of what rings enclose, px, and a mask."""
    drawn = np.zeros(mask.shape, np.uint8)
    cv2.fillPoly(drawn, [np.rint(np.array(ring)).astype(np.int32) for ring in rings], 1)
    return np.count_nonzero((drawn > 0) & mask) / np.count_nonzero((drawn > 0) | mask)


def on_plain_table(photo: Photo) -> Photo:
    """BALL's left photograph with a ball that a single view tells from the table by its colour."""
    left, bare = rendered_views(BALL)[0], rendered_views(None)[0]
    shown = np.abs(left.photo.pixels_bgr.astype(int) - bare.photo.pixels_bgr.astype(int)).max(axis=-1) > 3
    ball = cv2.morphologyEx(shown.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8)) > 0
    pixels = photo.pixels_bgr.copy()
    pixels[ball] = np.clip(pixels[ball] * np.array([0.3, 0.5, 1.2]), 0, 255).astype(np.uint8)
    return Photo(pixels)


def covered(view: View) -> View:
    """The view with a plain cloth over the sheet."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*(np.array(sheet_half_mm(SPEC)) + 3.0), 0]
    x, y, z = (corners @ view.rotation.T + view.translation_mm).T
    outline = np.column_stack([x, y]) / z[:, None] * view.camera.fx + [view.camera.cx, view.camera.cy]
    pixels = view.photo.pixels_bgr.copy()
    cv2.fillConvexPoly(pixels, np.rint(outline).astype(np.int32), (90, 90, 90))
    return replace(view, photo=replace(view.photo, pixels_bgr=pixels))
