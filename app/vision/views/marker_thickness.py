"""How high the print lies over the table where nobody announced it: 0 for a sheet of paper, or a plaque's thickness.

Points measured in a frame whose z = 0 is the print -> the plaque's thickness in mm, 0 for a sheet; and views moved to
the table frame of that thickness (CONVENTIONS.md, "Table frame").
"""

from dataclasses import replace

import numpy as np

from app.vision.board.print_layout import sheet_half_mm
from app.vision.geometry.topview import (
    CELLS_PER_FACT,
    MIN_POINTS_PER_TABLE_CELL,
    MIN_TABLE_POINTS,
    TABLE_CELL_MM,
    TREND_LIMIT,
    TREND_MM,
    TREND_SD_MM,
    TREND_UNIT_MM,
    view_from_above,
)
from app.vision.marker_spec import MarkerSpec
from app.vision.model import Float32Array, Float64Array, MaskArray, View
from app.vision.views.relative_pose import RefinedViews

# below, paper that curls and errors of the poses look the same: TREND_SD_MM twice
MIN_THICK_MM = 1.5
# a plaque; deeper, the marker lies on something else, or was moved (stillness.py)
MAX_FOUND_MM = 12.0
STEP_MM = 0.5  # between heights of the table that are tried
INLIER_MM = (3.0, 2.0, 1.5)  # narrowing, about the plane that is tried
MIN_SUPPORT_SHARE = 0.5  # of the best supported plane's cells: a lower one with so many is the table, the other a dish
NEAR_MM = 80.0  # around the sheet, where no slope hides its height
MIN_NEAR_CELLS = 15  # a tenth of what the table around a small board has
MIN_NEAR_RATIO = 1.5  # cells at the plane by cells at the print's height, where a plaque's sides and a dish may lie


def find_thickness(spec: MarkerSpec, points_print: Float32Array) -> float:
    """Thickness of the plaque that carries the print, mm; 0.0 where it lies on the table as a sheet does, or unclear.

    points_print: (n, 3) mm, beside the print, z from the print's plane. Nothing lies under a table: its plane, parallel
    to the print but for the poses' errors, is the lowest that many points share. It is believed where the table right
    beside the print lies there and not at the print's height.
    """
    low, high = -MAX_FOUND_MM - max(INLIER_MM), max(INLIER_MM) - MIN_THICK_MM + MAX_FOUND_MM
    z = points_print[:, 2]
    near_print = points_print[(z > low) & (z < high)]
    view = (
        view_from_above(near_print, near_print[:, 2], TABLE_CELL_MM)
        if len(near_print) >= MIN_TABLE_POINTS
        else None
    )
    if view is None:
        return 0.0
    kept = view.count >= MIN_POINTS_PER_TABLE_CELL
    xy, heights = view.centres_mm()[kept], view.height_mm[kept].astype(np.float64)
    planes = [
        _fit_plane(xy, heights, start) for start in -np.arange(0.0, MAX_FOUND_MM + STEP_MM, STEP_MM)
    ]
    support = np.array([np.count_nonzero(is_plane) for _, is_plane in planes])
    level = np.array([coefficients[0] for coefficients, _ in planes])
    lowest = level[support >= MIN_SUPPORT_SHARE * support.max()].min()
    # its cells' own best plane
    best = int(np.argmax(np.where(level <= lowest + max(INLIER_MM), support, -1)))
    coefficients, _ = planes[best]
    thick_mm = TREND_MM[0] - float(coefficients[0])
    if not MIN_THICK_MM < thick_mm <= MAX_FOUND_MM:
        return 0.0
    beyond = np.abs(xy) - sheet_half_mm(spec)
    is_near = (np.maximum(beyond, 0.0) ** 2).sum(axis=1) < NEAR_MM**2
    off = heights[is_near] - _terms(xy[is_near]) @ coefficients
    limit = min(max(INLIER_MM), thick_mm / 2)
    at_plane, at_print = (
        int(np.count_nonzero(np.abs(off - height) < limit)) for height in (0.0, thick_mm)
    )
    is_clear = at_plane >= MIN_NEAR_CELLS and at_plane >= MIN_NEAR_RATIO * at_print
    return round(thick_mm, 2) if is_clear else 0.0


def on_plaque(views: RefinedViews, thick_mm: float) -> RefinedViews:
    """The same views in the table frame of a plaque: the print, at z = 0 before, lies at z = thick_mm."""

    def lifted(view: View) -> View:
        marker = view.required_marker
        spec = replace(marker.spec, thick_mm=marker.spec.thick_mm + thick_mm)
        translation = view.translation_mm - view.rotation[:, 2] * thick_mm
        return replace(view, marker=replace(marker, spec=spec), translation_mm=translation)

    doubts = tuple((lifted(first), lifted(second)) for first, second in views.doubts)
    return replace(views, first=lifted(views.first), second=lifted(views.second), doubts=doubts)


def _fit_plane(
    xy: Float64Array, heights: Float64Array, start_mm: float
) -> tuple[Float64Array, MaskArray]:
    """(3,) height at the origin and slopes, (n,) cells at that plane, starting level at start_mm."""
    design = _terms(xy)
    prior = np.diag([0.0, *(1.0 / np.square(TREND_SD_MM[1:3]))]) * CELLS_PER_FACT
    coefficients = np.array([start_mm, 0.0, 0.0])
    is_plane = np.zeros(len(heights), np.bool_)
    for limit in INLIER_MM:
        is_plane = np.abs(heights - design @ coefficients) < limit
        if np.count_nonzero(is_plane) < MIN_NEAR_CELLS:
            return coefficients, np.zeros_like(is_plane)
        rows = design[is_plane]
        coefficients = np.linalg.solve(rows.T @ rows + prior, rows.T @ heights[is_plane])
    return coefficients, np.abs(heights - design @ coefficients) < INLIER_MM[-1]


def _terms(xy: Float64Array) -> Float64Array:
    unit = np.clip(xy / TREND_UNIT_MM, -TREND_LIMIT, TREND_LIMIT)
    return np.column_stack([np.ones(len(xy)), unit])
