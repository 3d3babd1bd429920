"""A depth map as parallax of the grid that its photograph stands on, and the view over the table where no marker is.

DepthMap, view and grid -> DisparityMap with its own noise; DepthMap and camera -> a View over the largest plane.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.geometry.projective import homogeneous
from app.vision.intrinsics import Camera
from app.vision.model import DepthMap, Float32Array, Float64Array, Photo, View
from app.vision.photograph.depth_map import MIN_NOISE_MM
from app.vision.views.aligned_depth import follow_camera
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import RectifiedPair
from app.vision.views.single_view import SingleView
from app.vision.views.table_plane import lowest_plane, table_from_plane, table_not_found

MATCH_AREA_PX = 100.0  # of its own grid, over which errors of a dense match are one
SAMPLES = 4000
# of the grid around a point, so that a surface that widens has no gaps
CORNERS = ((0, 0), (0, 1), (1, 0), (1, 1))
# of table_plane's tolerance, px: the depth map's noise in its units of inverse depth
PLANE_UNITS = 0.4
# between the camera's axis and the plane's normal: flatter, and it is a wall
MIN_TILT_COSINE = 0.17


def parallax_of_depth(pair: RectifiedPair, view: View, depth: DepthMap) -> DisparityMap:
    """The map of either view on the grid, which the first view's pixels are. NaN where the map shows nothing.

    The depth camera stands in its photograph's pose. What the second view measures moves along its row to where the
    first one sees it; the nearest of those that meet counts.
    """
    pinhole = np.array([[depth.fx, 0.0, depth.cx], [0.0, depth.fy, depth.cy], [0.0, 0.0, 1.0]])
    (inverse,) = _on_grid(pair, pinhole @ view.rotation, [1.0 / depth.depth_mm])
    disparity = pair.focal_px * pair.baseline_mm * inverse
    if np.linalg.norm(view.centre_mm - pair.first_centre_mm) > pair.baseline_mm / 2:
        disparity = _seen_from_first(disparity)
    scale = pair.focal_px / depth.fx  # px of the grid for one of the map
    relative = np.hypot(
        depth.sd_share, MIN_NOISE_MM / (pair.focal_px * pair.baseline_mm) * disparity
    )
    return DisparityMap(
        pair.parallax_from_disparity(disparity),
        np.full(pair.shape, 1.5 * scale, np.float32),
        disparity * relative,
        error_area_px=depth.error_area_px * scale**2,
    )


def parallax_of_match(
    pair: RectifiedPair, own: RectifiedPair, match: DisparityMap, sd_px: float
) -> DisparityMap:
    """The dense match of two views on the pair's grid. own: the two of them, of which one may be the pair's first.

    sd_px: least, of the match; MATCH_AREA_PX is over which its errors are one.
    """
    if match.sd_px is None:
        raise ValueError("A dense match has a standard deviation at each pixel.")
    if not np.allclose(own.first_centre_mm, pair.first_centre_mm):
        return _seen_from_elsewhere(pair, own, match, sd_px)
    grid = np.array(
        [
            [own.focal_px, 0.0, own.centre_px[0]],
            [0.0, own.focal_px, own.centre_px[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    shown = own.disparity_from_parallax(match.parallax_px)
    noise = np.fmax(match.sd_px, np.float32(sd_px))
    per_px = pair.focal_px * pair.baseline_mm / (own.focal_px * own.baseline_mm)
    disparity, sd, reach = _on_grid(pair, grid @ own.rotation, [shown, noise, match.reach_px])
    scale = pair.focal_px / own.focal_px
    return DisparityMap(
        pair.parallax_from_disparity(disparity * np.float32(per_px)),
        reach * np.float32(scale),
        sd * np.float32(per_px),
        error_area_px=MATCH_AREA_PX * scale**2,
    )


def _seen_from_elsewhere(
    pair: RectifiedPair, own: RectifiedPair, match: DisparityMap, least_sd_px: float
) -> DisparityMap:
    """The dense match of two other views where the pair's first view sees its points; the nearest of them count."""
    rows, columns = np.nonzero(np.isfinite(match.parallax_px))
    disparity = own.disparity_from_parallax(match.parallax_px)[rows, columns].astype(np.float64)
    depth = own.focal_px * own.baseline_mm / np.maximum(disparity, 1e-6)
    rays = own.rays(np.column_stack([columns, rows]).astype(np.float64))
    x, y, z = pair.project((rays * depth[:, None]) @ own.rotation + own.first_centre_mm).T
    sd = (
        np.fmax(match.sd_px[rows, columns], least_sd_px)
        if match.sd_px is not None
        else np.full(len(x), least_sd_px)
    )
    scale = pair.focal_px / z * depth / own.focal_px  # px of the grid for one of theirs
    per_px = pair.focal_px * pair.baseline_mm / z**2 * depth / disparity
    values = np.column_stack(
        [pair.focal_px * pair.baseline_mm / z, sd * per_px, match.reach_px[rows, columns] * scale]
    )
    order = np.argsort(np.where(z > 0, -values[:, 0], np.inf), kind="stable")  # the nearest first
    places = np.floor(np.column_stack([y, x])[order]).astype(np.int64)
    at = (places[:, None] + np.array(CORNERS)).reshape(-1, 2)
    value = np.repeat(values[order], len(CORNERS), axis=0)
    inside = (at >= 0).all(axis=1) & (at < pair.shape).all(axis=1) & (value[:, 0] > 0)
    cells, nearest = np.unique(
        np.ravel_multi_index(tuple(at[inside].T), pair.shape), return_index=True
    )
    out = np.full((*pair.shape, 3), np.nan, np.float32)
    out.reshape(-1, 3)[cells] = value[inside][nearest]
    return DisparityMap(
        pair.parallax_from_disparity(out[..., 0]),
        np.nan_to_num(out[..., 2]),
        np.ascontiguousarray(out[..., 1]),
        error_area_px=MATCH_AREA_PX * float(np.median(scale)) ** 2 if len(scale) else MATCH_AREA_PX,
    )


def _on_grid(
    pair: RectifiedPair, to_map: Float64Array, maps: Sequence[Float32Array]
) -> list[Float32Array]:
    """Inverse depths, or multiples of them, as a camera in the first or second view's place shows them, on the grid.

    to_map: (3, 3) table frame to the camera's homogeneous pixels, K R: a homography maps the grid's rays to these.
    """
    height, width = pair.shape
    grid = np.array(
        [
            [pair.focal_px, 0.0, pair.centre_px[0]],
            [0.0, pair.focal_px, pair.centre_px[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    homography = (to_map @ pair.rotation.T @ np.linalg.inv(grid)).astype(np.float32)
    u, v = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    x, y, z = (row[0] * u + row[1] * v + row[2] for row in homography)
    z = np.where(z > 0, z, np.float32(np.nan))  # of the camera's axis for one of the grid's
    places = x / z, y / z
    return [
        np.asarray(z * cv2.remap(each, *places, cv2.INTER_LINEAR, borderValue=np.nan), np.float32)
        for each in maps
    ]


def _seen_from_first(disparity_px: Float32Array) -> Float32Array:
    """(H, W) disparity at the second view's pixels -> at the first view's; NaN where nothing comes to lie."""
    width = disparity_px.shape[1]
    rows, columns = np.nonzero(np.isfinite(disparity_px))
    order = np.argsort(disparity_px[rows, columns])  # the nearest is written last
    rows, columns = rows[order], columns[order]
    values = disparity_px[rows, columns]
    out = np.full(disparity_px.shape, np.nan, np.float32)
    for more in (0, 1):  # either neighbour, so that a surface that widens has no gaps
        target = np.floor(columns + values).astype(np.int64) + more
        inside = (target >= 0) & (target < width)
        moved = np.full(out.shape, np.nan, np.float32)
        moved[rows[inside], target[inside]] = values[inside]
        out = np.fmax(out, moved)
    return out


def place_by_depth(
    photo: Photo, camera: Camera, depth: DepthMap, rng: np.random.Generator
) -> SingleView | Failure:
    """The view over the lowest large plane of its metric depth map. Failure "table_not_found"."""
    depth = follow_camera(depth, camera)
    rows, columns = np.nonzero(np.isfinite(depth.depth_mm))
    chosen = rng.choice(len(rows), min(SAMPLES, len(rows)), replace=False)
    pixels = homogeneous(np.column_stack([columns[chosen], rows[chosen]]).astype(np.float64))
    inverse = 1.0 / depth.depth_mm[rows[chosen], columns[chosen]].astype(np.float64)
    # In units in which the noise is a third of what a point may be off a plane.
    unit = PLANE_UNITS / (3.0 * max(depth.sd_share, 0.002) * float(np.median(inverse)))
    fitted = lowest_plane(pixels, inverse * unit, rng)
    if fitted is None:
        return table_not_found("no plane is shared by enough of the depth map")
    # 1 / Z = a x + b y + c at x = fx X / Z + cx: a fx X + b fy Y + (a cx + b cy + c) Z = 1
    a, b, c = fitted / unit
    normal: Float64Array = np.array([a * depth.fx, b * depth.fy, a * depth.cx + b * depth.cy + c])
    length = float(np.linalg.norm(normal))
    plane = np.append(-normal / length, 1.0 / length)
    if -plane[2] < MIN_TILT_COSINE:
        return table_not_found("the largest plane is nearly in line with the camera")
    rotation, translation_mm = table_from_plane(plane)
    return SingleView(View(photo, camera, None, rotation, translation_mm, 0.0), ())
