"""Depth maps whose pixels are their photograph's, reduced (HEIC): the pinhole of the view, and the scale of its marker.

DepthMap and view -> a metric DepthMap of a pinhole, or None where the table does not tell the scale.
"""

from dataclasses import replace

import cv2
import numpy as np

from app.vision.geometry.projective import homogeneous
from app.vision.intrinsics import Camera
from app.vision.model import DepthMap, Float64Array, View
from app.vision.views.features import shows_sheet

MAX_COMPARED = 40_000  # pixels of a map
MIN_COMPARED = 100
MAX_SCALE_SD = 0.03  # of a relative map's scale, which is that of all heights
MAX_SHEET_ERROR = 0.02  # of the depth, in the middle over the sheet
NEAR_SD = 2.5  # standard deviations within which a pixel counts as the table's
LEAST_SD_SHARE = 0.002  # of the depth: a table is no plane to more than that
ROUNDS = 12  # in which the table grows from the sheet to the picture's border


def depth_in_view(depth: DepthMap, view: View) -> DepthMap | None:
    """The map as a metric one of a pinhole in the view's pose; None if it is relative and no table scales it."""
    depth = follow_camera(depth, view.camera)
    return _scaled_by_table(depth, view) if depth.is_relative else depth


def follow_camera(depth: DepthMap, camera: Camera) -> DepthMap:
    """The map with the camera's intrinsics, its distortion taken out; one of a pinhole of its own as it is."""
    if not depth.is_aligned:
        return depth
    height, width = depth.depth_mm.shape
    x_scale, y_scale = width / camera.width, height / camera.height
    fx, fy = camera.fx * x_scale, camera.fy * y_scale
    cx, cy = (camera.cx + 0.5) * x_scale - 0.5, (camera.cy + 0.5) * y_scale - 0.5
    depth_mm = depth.depth_mm
    if any(camera.distortion):
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        size = (width, height)
        maps = cv2.initUndistortRectifyMap(
            matrix, np.array(camera.distortion), np.eye(3), matrix, size, cv2.CV_32FC1
        )
        depth_mm = np.asarray(
            cv2.remap(depth_mm, *maps, cv2.INTER_NEAREST, borderValue=np.nan), np.float32
        )
    return replace(depth, depth_mm=depth_mm, fx=fx, fy=fy, cx=cx, cy=cy, is_aligned=False)


def _scaled_by_table(depth: DepthMap, view: View) -> DepthMap | None:
    """The metric map of a relative one: its numbers are fitted to the inverse depth of the table, sheet first."""
    if view.marker is None:
        return None
    height, width = depth.depth_mm.shape
    step = max(1, int(np.ceil(np.sqrt(height * width / MAX_COMPARED))))
    rows, columns = (index.ravel() for index in np.mgrid[0:height:step, 0:width:step])
    shown = 1.0 / depth.depth_mm[rows, columns].astype(np.float64)
    pixels = np.column_stack([(columns - depth.cx) / depth.fx, (rows - depth.cy) / depth.fy])
    rays = homogeneous(pixels) @ view.rotation
    centre = view.centre_mm
    is_compared = np.isfinite(shown) & (rays[:, 2] < 0)
    shown, rays = shown[is_compared], rays[is_compared]
    plane_mm = (centre - rays * (centre[2] / rays[:, 2:])).astype(np.float32)
    is_sheet = shows_sheet(view.marker, plane_mm, centre)
    table = -rays[:, 2] / np.where(is_sheet, centre[2] - view.marker.spec.thick_mm, centre[2])
    if np.count_nonzero(is_sheet) < MIN_COMPARED:
        return None
    noise = depth.sd_share * float(np.median(shown[is_sheet]))
    is_table = is_sheet
    slope, offset = 0.0, 0.0
    for _ in range(ROUNDS):
        middle = float(np.mean(table[is_table]))
        span = table[is_table] - middle
        if not (span @ span > 0 and span @ shown[is_table] > 0):
            return None
        slope = float(span @ shown[is_table] / (span @ span))
        offset = float(np.mean(shown[is_table])) - slope * middle
        off = np.abs(shown - slope * table - offset)
        spread = float(np.median(off[is_sheet])) / 0.6745
        is_table = is_sheet | (off < NEAR_SD * np.hypot(spread, LEAST_SD_SHARE * slope * table))
    # Of what the table shows; pixels whose errors are one count as one.
    facts = np.count_nonzero(is_table) * min(1.0, step**2 / depth.error_area_px)
    sd = max(noise, float(np.std((shown - slope * table - offset)[is_table])))
    scale_sd = sd / (slope * float(np.std(table[is_table])) * np.sqrt(facts))
    sheet_error = float(np.median((shown - offset)[is_sheet] / (slope * table[is_sheet]))) - 1.0
    if scale_sd > MAX_SCALE_SD or abs(sheet_error) > MAX_SHEET_ERROR:
        return None
    metric: Float64Array = (1.0 / depth.depth_mm.astype(np.float64) - offset) / slope
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_mm = np.where(metric > 0, 1.0 / metric, np.nan).astype(np.float32)
    sd_share = sd / (slope * float(np.median(table[is_sheet])))
    return replace(depth, depth_mm=depth_mm, sd_share=sd_share, is_relative=False)
