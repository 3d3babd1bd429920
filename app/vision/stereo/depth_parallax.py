"""A depth map as the parallax of a single view, and the view over the table that it shows where there is no marker.

DepthMap and the grid -> DisparityMap with its own noise; DepthMap and camera -> a View over the largest plane.
"""

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.depth_map import MIN_NOISE_MM
from app.vision.geometry.projective import homogeneous
from app.vision.intrinsics import Camera
from app.vision.model import DepthMap, Float64Array, Photo, View
from app.vision.stereo.disparity import DisparityMap
from app.vision.stereo.rectification import RectifiedPair
from app.vision.stereo.single_view import SingleView
from app.vision.stereo.table_plane import lowest_plane, table_from_plane, table_not_found

SAMPLES = 4000
PLANE_UNITS = 0.4  # of table_plane's tolerance, px: the depth map's noise in its units of inverse depth
MIN_TILT_COSINE = 0.17  # between the camera's axis and the plane's normal: flatter, and it is a wall


def parallax_of_depth(pair: RectifiedPair, depth: DepthMap) -> DisparityMap:
    """The map on a single view's grid. Its axes are the grid's, for the depth camera stands in the view's pose."""
    height, width = pair.shape
    u = (np.arange(width, dtype=np.float32) - pair.centre_px[0]) / pair.focal_px
    v = (np.arange(height, dtype=np.float32) - pair.centre_px[1]) / pair.focal_px
    columns, rows = np.meshgrid(depth.fx * u + depth.cx, depth.fy * v + depth.cy)
    places = columns.astype(np.float32), rows.astype(np.float32)
    inverse = cv2.remap(1.0 / depth.depth_mm, *places, cv2.INTER_LINEAR, borderValue=np.nan)
    disparity = pair.focal_px * pair.baseline_mm * inverse
    parallax = (disparity - pair.plane_disparity_px()) / (1.0 - pair.plane_px[0])
    scale = pair.focal_px / depth.fx  # px of the grid for one of the map
    relative = np.hypot(depth.sd_share, MIN_NOISE_MM * inverse)
    return DisparityMap(
        np.asarray(parallax, np.float32),
        np.full(pair.shape, 1.5 * scale, np.float32),
        np.asarray(disparity * relative, np.float32),
        error_area_px=depth.error_area_px * scale**2,
    )


def place_by_depth(photo: Photo, camera: Camera, depth: DepthMap, rng: np.random.Generator) -> SingleView | Failure:
    """The view over the lowest large plane of its depth map. Failure "table_not_found"."""
    rows, columns = np.nonzero(np.isfinite(depth.depth_mm))
    chosen = rng.choice(len(rows), min(SAMPLES, len(rows)), replace=False)
    pixels = homogeneous(np.column_stack([columns[chosen], rows[chosen]]).astype(np.float64))
    inverse = 1.0 / depth.depth_mm[rows[chosen], columns[chosen]].astype(np.float64)
    # In units in which the noise is a third of what a point may be off a plane.
    unit = PLANE_UNITS / (3.0 * max(depth.sd_share, 0.002) * float(np.median(inverse)))
    fitted = lowest_plane(pixels, inverse * unit, rng)
    if fitted is None:
        return table_not_found("no plane is shared by enough of the depth map")
    a, b, c = fitted / unit  # 1 / Z = a x + b y + c at x = fx X / Z + cx: a fx X + b fy Y + (a cx + b cy + c) Z = 1
    normal: Float64Array = np.array([a * depth.fx, b * depth.fy, a * depth.cx + b * depth.cy + c])
    length = float(np.linalg.norm(normal))
    plane = np.append(-normal / length, 1.0 / length)
    if -plane[2] < MIN_TILT_COSINE:
        return table_not_found("the largest plane is nearly in line with the camera")
    rotation, translation_mm = table_from_plane(plane)
    return SingleView(View(photo, camera, None, rotation, translation_mm, 0.0), ())
