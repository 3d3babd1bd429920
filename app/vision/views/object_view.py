"""A photograph placed over the table by a coin that lies there: distance and tilt from its ellipse.

Ellipse and camera -> SingleView. The table frame's origin is on the table under the coin's middle,
x to the photograph's right. A circle's ellipse leaves two normals, and is hardly flattened where a
phone looks down: how phones are held decides there.
"""

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from app.vision.geometry.ellipse import Ellipse
from app.vision.geometry.projective import homogeneous
from app.vision.intrinsics import Camera
from app.vision.known_object import KnownObject
from app.vision.model import Float64Array, Photo, View
from app.vision.views.features import undistort_to_rays
from app.vision.views.single_view import SingleView

EDGE_SD_PX = 0.5  # of a half-axis
# of its diameter in the picture: its edge is round, and which line of it is seen depends on the light
SIZE_SD = 0.02
# Of focal lengths, relative, which a coin does not tell: 35 mm equivalents are rounded, and crops are
# not told; where nothing is told, main cameras of phones lie evenly between 22 and 35 mm.
FOCAL_SDS: Mapping[str, float] = {"given": 0.0, "exif": 0.03, "board": 0.13}
# How phones are held, radians: the table's normal in the camera's frame lies in the plane of its
# upright and its axis, and leans back by anything from a view from above to one from a chair;
# nobody reaches over a meal to photograph it from beyond.
ROLL_SD, TILT, TILT_SD, LEAN_SD = 0.1, 0.25, 0.4, 0.1
ROLLS, TILTS, GRID = (-0.5, 0.5), (-0.5, 1.4), 121
LEAST_TILT_SD = 0.02


def place_by_object(
    photo: Photo, camera: Camera, ellipse: Ellipse, known: KnownObject
) -> SingleView:
    """Return the view that a coin's ellipse shows, px of the photograph, and its doubts."""
    flat = View(photo, camera, None, np.eye(3), np.zeros(3), 0.0, known=known)
    rays = homogeneous(undistort_to_rays(flat, ellipse.points()))
    centre, normal = _circle_in_camera(rays, known.diameter_mm / 2)
    normal, (roll_sd, tilt_sd) = _as_held(centre, normal, ellipse)
    view = _over_table(flat, centre, normal, known.thick_mm)
    farther = _over_table(flat, centre * (1 + size_sd(ellipse)), normal, known.thick_mm)
    tilted = [
        _over_table(flat, centre, _turned(normal, axis), known.thick_mm)
        for axis in (view.rotation[:, 0] * tilt_sd, view.rotation[:, 1] * roll_sd)
    ]
    sd = FOCAL_SDS[camera.source]
    return SingleView(view, (farther, *tilted, *([zoomed(view, 1 + sd)] if sd > 0 else ())))


def size_sd(ellipse: Ellipse) -> float:
    """Return the relative sd of a coin's size in a photograph."""
    return float(np.hypot(EDGE_SD_PX / ellipse.radius, SIZE_SD))


def zoomed(view: View, longer: float) -> View:
    """Return the view as it would be by a lens that is longer by a factor: all is the farther away."""
    camera = replace(view.camera, fx=view.camera.fx * longer, fy=view.camera.fy * longer)
    return replace(view, camera=camera, translation_mm=view.translation_mm * [1, 1, longer])


def _circle_in_camera(rays: Float64Array, radius_mm: float) -> tuple[Float64Array, Float64Array]:
    """Return the middle (3,) mm and the normal (3,), towards the camera, of a circle seen along rays (n, 3).

    One of the two circles that are seen so; the other's normal is its mirror image about the ray to the middle. After
    Q. Chen, H. Wu and T. Wada, Camera calibration with two arbitrary coplanar circles (2004).
    """
    x, y = rays[:, 0], rays[:, 1]
    design = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    a, b, c, d, e, f = np.linalg.svd(design)[2][-1]
    cone = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]])
    values, vectors = np.linalg.eigh(cone)
    if np.count_nonzero(values > 0) == 1:
        values, vectors = -values[::-1], vectors[:, ::-1]
    third, second, first = values
    axes = vectors[:, ::-1]
    across = np.sqrt(max(first - second, 0.0) / (first - third))
    along = np.sqrt((second - third) / (first - third))
    reach = second * radius_mm / np.sqrt(-first * third)
    centre = reach * axes @ [third / second * across, 0.0, -first / second * along]
    normal = axes @ [across, 0.0, -along]
    centre = centre if centre[2] > 0 else -centre
    return centre, normal if normal @ centre < 0 else -normal


def _as_held(
    centre: Float64Array, normal: Float64Array, ellipse: Ellipse
) -> tuple[Float64Array, tuple[float, float]]:
    """Return the normal as both its ellipse and how phones are held have it, and its sds, to the right and up.

    An ellipse tells the normal's part across the line of sight, but for its sign, and near the line of sight but
    badly: its aspect is the cosine.
    """
    towards = -centre / np.linalg.norm(centre)
    right = _unit(np.cross([0.0, 1.0, 0.0], towards))
    across = np.stack([right, np.cross(towards, right)])
    x, y = np.meshgrid(*(np.sin(np.linspace(*limits, GRID)) for limits in (ROLLS, TILTS)))
    depth = 1.0 - x**2 - y**2
    x, y, depth = (values[depth > 0] for values in (x, y, depth))
    normals = np.column_stack([x, -y, -np.sqrt(depth)])
    apart = _doubled(normals @ across.T) - _doubled(across @ normal)
    aspect_sd = 2 * EDGE_SD_PX / ellipse.radius
    log_odds = -0.5 * np.square(apart / aspect_sd).sum(axis=1)
    log_odds -= 0.5 * (x / ROLL_SD) ** 2 + 0.5 * ((y - np.sin(TILT)) / TILT_SD) ** 2
    log_odds -= 0.5 * (np.minimum(y, 0.0) / LEAN_SD) ** 2
    odds = np.exp(log_odds - log_odds.max())
    odds /= odds.sum()
    mean = odds @ normals
    roll_sd, tilt_sd = np.sqrt(odds @ np.square(normals - mean))[:2]
    return _unit(mean), (max(float(roll_sd), LEAST_TILT_SD), max(float(tilt_sd), LEAST_TILT_SD))


def _doubled(across: Float64Array) -> Float64Array:
    """Return (..., 2) of directions (..., 2) with twice their angle: the same for both signs."""
    u, v = across[..., 0], across[..., 1]
    return np.stack([u * u - v * v, 2 * u * v], axis=-1)


def _unit(direction: Float64Array) -> Float64Array:
    return direction / np.linalg.norm(direction)


def _turned(direction: Float64Array, by: Float64Array) -> Float64Array:
    return cv2.Rodrigues(by)[0] @ direction


def _over_table(view: View, centre: Float64Array, normal: Float64Array, thick_mm: float) -> View:
    """Return the view with the table `thick_mm` under a circle. centre, normal: (3,) in the camera's frame."""
    right = _unit(np.array([1.0, 0.0, 0.0]) - normal[0] * normal)
    rotation = np.column_stack([right, np.cross(normal, right), normal])
    return replace(view, rotation=rotation, translation_mm=centre - thick_mm * normal)
