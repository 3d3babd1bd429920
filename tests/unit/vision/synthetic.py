"""Synthetic photographs of a printed board on a table, seen by a known camera from a known place: the tests' truth.

render_board projects exactly (lens distortion and bent paper too) and averages over each pixel's area.
"""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np

from app.vision.intrinsics import Camera
from app.vision.marker_spec import COLOUR_SQUARES, MarkerSpec
from app.vision.model import Float64Array, ImageArray, Photo

PHONE = Camera(1200, 900, 975.0, 975.0, 599.5, 449.5, source="given")
WHITE, BLACK, TABLE = 0.84, 0.035, 0.25  # reflectance
OVERSAMPLING = 3  # rays a pixel, in x and in y
STRIP_ROWS = 30  # rendered at a time: their rays fit into the processor's cache


@dataclass(frozen=True)
class Pose:
    """Table to camera: x_camera = rotation @ x_table + translation_mm."""

    rotation: Float64Array
    translation_mm: Float64Array

    @property
    def centre_mm(self) -> Float64Array:
        return -self.rotation.T @ self.translation_mm


def look_at(elevation_deg=50.0, azimuth_deg=-90.0, distance_mm=350.0, roll_deg=0.0, target_mm=(0.0, 0.0, 0.0)) -> Pose:
    """A camera that looks at target_mm; azimuth -90: from the print's lower edge; roll 0: image x is horizontal."""
    elevation, azimuth, roll = np.radians([elevation_deg, azimuth_deg, roll_deg])
    offset = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    centre = np.asarray(target_mm) + distance_mm * np.array(offset)
    forward = -np.array(offset)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    down = np.cross(forward, right)
    turned_right = np.cos(roll) * right + np.sin(roll) * down
    turned_down = -np.sin(roll) * right + np.cos(roll) * down
    rotation = np.stack([turned_right, turned_down, forward])
    return Pose(rotation, -rotation @ centre)


def project(camera: Camera, pose: Pose, points_table: Float64Array) -> Float64Array:
    """(n, 3) mm -> (n, 2) px."""
    rotation_vector = cv2.Rodrigues(pose.rotation)[0]
    lens = camera.matrix, np.array(camera.distortion)
    return cv2.projectPoints(points_table, rotation_vector, pose.translation_mm, *lens)[0].reshape(-1, 2)


def corner_points(spec: MarkerSpec) -> Float64Array:
    """(n, 3) inner corners as CONVENTIONS.md numbers them, by its formula, corner by corner."""
    places = [(c, r) for r in range(spec.rows - 1) for c in range(spec.columns - 1)]
    return np.array([(c + 1 - spec.columns / 2, spec.rows / 2 - r - 1, 0.0) for c, r in places]) * spec.square_mm


def render_board(
    spec, camera, pose, *, shadow=1.0, exposure=1.0, noise=1.5, blur_px=0.6, table: Float64Array | None = None, seed=0
) -> Photo:
    """A photograph of the board on its table.

    shadow: light left on the part of the table where x > y / 2. exposure: factor on all light. noise: grey levels.
    table: (k, k, 3) reflectance, BGR, of 2 mm squares around the board's middle, repeated; None: grey.
    """
    whole = np.array([[0, 0], [camera.width, camera.height]])
    light = _light(spec, camera, pose, whole, 1, shadow, table)
    reach = 0.75 * np.hypot(spec.columns + 2, spec.rows + 2) * spec.square_mm
    outline = project(camera, pose, reach * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float))
    box = np.clip(np.rint([outline.min(axis=0), outline.max(axis=0)]).astype(int), 0, whole[1])
    if (box[1] > box[0]).all():  # only the board has edges that matter
        fine = _light(spec, camera, pose, box, OVERSAMPLING, shadow, table)
        light[box[0, 1] : box[1, 1], box[0, 0] : box[1, 0]] = fine
    light = cv2.GaussianBlur(light, (0, 0), blur_px)  # lenses blur light, before the tone curve
    grey = np.random.default_rng(seed).normal(0.5, noise, light.shape)
    grey += 255.0 * cv2.pow(np.minimum(light * np.float32(exposure), 1.0), 1 / 2.2)
    return Photo(np.clip(grey, 0, 255, out=grey).astype(np.uint8))


def noise_texture(seed: int, size: int = 200) -> Float64Array:
    """(size, size, 3) a table with patches of all sizes."""
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size, 3))
    for cells in (6, 12, 25, 50, 100, 200):
        total += cv2.resize(rng.uniform(-1, 1, (cells, cells, 3)), (size, size), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(0.3 + 0.1 * total, 0.02, 0.9))


def _light(spec, camera, pose, box, samples, shadow, table) -> np.ndarray:
    """Light from the pixels of box ((x0, y0), (x1, y1)): (H, W, 3) float32, mean of samples x samples rays each."""
    columns = box[1, 0] - box[0, 0]
    strips = []
    for top in range(box[0, 1], box[1, 1], STRIP_ROWS):
        rows = min(STRIP_ROWS, box[1, 1] - top)
        total = np.zeros((rows, columns, 3), np.float32)
        for down in range(samples):
            for across in range(samples):
                offset = [box[0, 0], top] + (np.array([across, down]) + 0.5) / samples - 0.5
                x, y = _table_points(camera, pose, offset, rows, columns)
                light = _reflectance(spec, x, y, table)
                total += light if shadow == 1.0 else light * np.where(x > y / 2, shadow, 1.0)[..., None]
        strips.append(total / samples**2)
    return np.concatenate(strips)


def _table_points(camera, pose, offset, rows, columns):
    """Where the rays of rows x columns px from offset on meet z = 0, mm; NaN above the horizon. Two (rows, columns)."""
    across, down = np.arange(columns) + offset[0], np.arange(rows)[:, None] + offset[1]
    if any(camera.distortion):
        pixels = np.stack(np.broadcast_arrays(across, down), -1).reshape(-1, 1, 2)
        ideal = cv2.undistortPoints(pixels, camera.matrix, np.array(camera.distortion), P=camera.matrix)
        across, down = ideal.reshape(rows, columns, 2).transpose(2, 0, 1)
    from_plane = camera.matrix @ np.column_stack([pose.rotation[:, :2], pose.translation_mm])
    to_plane = np.linalg.inv(from_plane)  # (x, y, 1) / depth
    inverse_depth = to_plane[2, 0] * across + to_plane[2, 1] * down + to_plane[2, 2]
    depth = 1.0 / np.where(inverse_depth > 0, inverse_depth, np.nan)
    x, y = ((row[0] * across + row[1] * down + row[2]) * depth for row in to_plane[:2])
    return x, y


def _reflectance(spec, x, y, table) -> Float64Array:
    """(H, W, 3) BGR: squares, white margin of one square, table."""
    column = np.floor(x / spec.square_mm + spec.columns / 2)  # NaN above the horizon, which is on no sheet
    row = np.floor(spec.rows / 2 - y / spec.square_mm)
    if table is None:
        out = np.full((x.size, 3), TABLE, np.float32)
    else:
        across, down = (_texel(place, side) for place, side in ((x, table.shape[1]), (-y, table.shape[0])))
        texels = table.reshape(-1, 3).astype(np.float32)
        out = texels.take((down * table.shape[1] + across).ravel(), axis=0)
    sheet = np.flatnonzero((column >= -1) & (column <= spec.columns) & (row >= -1) & (row <= spec.rows))
    on_sheet = (row.ravel()[sheet] + 1) * (spec.columns + 2) + column.ravel()[sheet] + 1
    out[sheet] = _sheet_of(spec).reshape(-1, 3).take(on_sheet.astype(np.intp), axis=0)
    return out.reshape(*x.shape, 3)


def _texel(place_mm, side) -> np.ndarray:
    """Which of side squares of 2 mm, repeated, a place is in; the middle one if it is NaN."""
    if np.isnan(place_mm).any():
        place_mm = np.nan_to_num(place_mm)
    return (np.floor(place_mm / 2).astype(np.intp) + side // 2) % side


@cache
def _sheet_of(spec: MarkerSpec) -> np.ndarray:
    """(rows + 2, columns + 2, 3) float32, BGR: the squares within their margin."""
    sheet = np.full((spec.rows + 2, spec.columns + 2, 3), WHITE, np.float32)
    if spec.kind == "plain":
        row, column = np.mgrid[: spec.rows, : spec.columns]
        sheet[1:-1, 1:-1][(row + column) % 2 == 0] = BLACK
    else:
        for (row, column), srgb in COLOUR_SQUARES.items():
            sheet[row + 1, column + 1] = (np.array(srgb[::-1]) / 255) ** 2.2
    return sheet


def paint_over(photo: Photo, polygon_px: Float64Array, grey: int = 90) -> Photo:
    """The photograph with something grey lying on it."""
    pixels: ImageArray = photo.pixels_bgr.copy()
    cv2.fillPoly(pixels, [np.rint(polygon_px).astype(np.int32)], (grey, grey, grey))
    return replace(photo, pixels_bgr=pixels)
