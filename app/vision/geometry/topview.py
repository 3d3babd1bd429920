"""The meal seen from straight above: the median height of the measured points in each cell of the table's plane.

Points (mm, table frame) -> a grid of heights; and the table's own slow departure from the marker's plane, which a
small error of the poses or a soft cloth makes, so that heights can be taken over the table itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.masks import dilated
from app.vision.geometry.pictures import scaled_and_shifted
from app.vision.model import Float32Array, Float64Array, MaskArray

CELL_MM = 3.0
TABLE_CELL_MM = 8.0
HEIGHT_STEP_MM = 0.02  # of the medians
HEIGHT_LIMIT_MM = 600.0
HEIGHT_BITS = 17  # hold twice the limit in such steps
REACH_MM = 600.0  # from the marker: farther points are background or strays
MARGIN_MM = 40.0
TREND_UNIT_MM = 200.0
TREND_LIMIT = 2.5  # units; the trend is not carried on beyond
# Prior of the coefficients, constant, linear, quadratic: a sheet lies on the table and its edges curl up; what errors
# of the poses make of a plane is nearly one.
TREND_MM = (-0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
TREND_SD_MM = (0.7, 1.5, 1.5, 0.7, 0.7, 0.7)
CELLS_PER_FACT = 150.0  # neighbouring cells err alike, so many count as one measurement
# narrowing: what lies farther from the trend is no table
INLIER_MM = (6.0, 6.0, 5.0, 5.0, 4.0, 4.0)
TABLE_RANGE_MM = 40.0
MIN_TABLE_POINTS = 500
MIN_POINTS_PER_TABLE_CELL = 4
STANDING_MM = 10.0  # over the marker's plane: no trend of a table
BESIDE_CELLS = 2


@dataclass(frozen=True, slots=True)
class TopView:
    """origin_mm: (2,) corner of cell (0, 0). height_mm: (rows, columns) median, NaN where empty; y grows with rows.

    count: (rows, columns) points in each cell.
    """

    origin_mm: Float64Array
    cell_mm: float
    height_mm: Float32Array
    count: NDArray[np.int64]

    def cells_px(self, xy_mm: Float64Array | Float32Array) -> Float32Array:
        """(H, W, 2) mm -> (H, W, 2) column and row, a cell's centre being whole."""
        return scaled_and_shifted(
            np.asarray(xy_mm, np.float32),
            1.0 / self.cell_mm,
            -self.origin_mm / self.cell_mm - 0.5,
        )

    def centres_mm(self) -> Float64Array:
        """(rows, columns, 2) x, y of the cells' centres, mm."""
        rows, columns = self.height_mm.shape
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        return self.origin_mm + (grid + 0.5) * self.cell_mm


@dataclass(frozen=True, slots=True)
class TableTrend:
    """Height of the table over the marker's plane as a polynomial of second degree in x, y; noise_mm: of a cell."""

    coefficients: Float64Array
    noise_mm: float

    def height_mm(self, xy_mm: Float64Array | Float32Array) -> Float64Array:
        """(...,) mm at (..., 2) mm; NaN kept."""
        unit = np.clip(np.asarray(xy_mm, np.float64) / TREND_UNIT_MM, -TREND_LIMIT, TREND_LIMIT)
        return np.tensordot(self.coefficients, _terms(unit[..., 0], unit[..., 1]), axes=1)


def view_from_above(
    points_table: Float32Array, heights_mm: Float32Array, cell_mm: float = CELL_MM
) -> TopView | None:
    """The top view of (n, 3) points with (n,) heights (over the table or the marker); None without points."""
    if len(points_table) == 0:
        return None
    x, y = (np.ascontiguousarray(points_table[:, axis], np.float64) for axis in (0, 1))
    origin = np.array([x.min(), y.min()]) - MARGIN_MM
    columns, rows = (np.ceil((np.array([x.max(), y.max()]) + MARGIN_MM - origin) / cell_mm)).astype(
        np.int64
    )
    # Both are positive, so that cutting off the fraction is rounding down.
    column, row = ((each - least) / cell_mm for each, least in ((x, origin[0]), (y, origin[1])))
    index = row.astype(np.int64) * columns + column.astype(np.int64)
    count = np.bincount(index, minlength=int(rows * columns))
    # One sort of whole numbers, the cell before the height, is several times as fast as sorting by two keys.
    steps = np.rint(np.clip(heights_mm, -HEIGHT_LIMIT_MM, HEIGHT_LIMIT_MM) / HEIGHT_STEP_MM).astype(
        np.int64
    )
    order = np.sort((index << HEIGHT_BITS) + steps + (1 << (HEIGHT_BITS - 1)))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    median = np.full(int(rows * columns), np.nan, np.float32)
    filled = count > 0
    middle = order[first[filled] + count[filled] // 2] & ((1 << HEIGHT_BITS) - 1)
    median[filled] = (middle - (1 << (HEIGHT_BITS - 1))) * HEIGHT_STEP_MM
    shape = (int(rows), int(columns))
    return TopView(origin, cell_mm, median.reshape(shape), count.reshape(shape))


def usable_points(points_table: Float32Array, ignored: MaskArray) -> MaskArray:
    """(H, W) where a point is measured, not ignored and within reach."""
    near = (np.abs(points_table[..., 0]) < REACH_MM) & (np.abs(points_table[..., 1]) < REACH_MM)
    return np.isfinite(points_table[..., 2]) & near & ~ignored


def fit_table_trend(points_table: Float32Array) -> TableTrend:
    """Ridge regression on the cells near the marker's plane, gathered anew as it improves. points_table: (n, 3)."""
    expected = np.array(TREND_MM)
    coefficients: Float64Array = expected
    near = points_table[np.abs(points_table[:, 2]) < TABLE_RANGE_MM]
    view = (
        view_from_above(near, near[:, 2], TABLE_CELL_MM) if len(near) >= MIN_TABLE_POINTS else None
    )
    if view is None:
        return TableTrend(coefficients, 1.0)
    kept = view.count >= MIN_POINTS_PER_TABLE_CELL
    kept &= ~_beside_what_stands(view)
    heights = view.height_mm[kept].astype(np.float64)
    unit = view.centres_mm()[kept] / TREND_UNIT_MM
    design = _terms(unit[:, 0], unit[:, 1]).T
    prior = np.diag(1.0 / np.square(TREND_SD_MM)) * CELLS_PER_FACT
    is_table = np.ones(len(heights), np.bool_)
    for limit in INLIER_MM:
        is_table = np.abs(heights - design @ coefficients) < limit
        rows = design[is_table]
        solved = np.linalg.solve(
            rows.T @ rows + prior, rows.T @ heights[is_table] + prior @ expected
        )
        coefficients = solved
    residuals = np.abs(heights - design @ coefficients)[is_table]
    return TableTrend(coefficients, 1.48 * float(np.median(residuals)) if residuals.size else 1.0)


def _beside_what_stands(view: TopView) -> MaskArray:
    """(rows, columns) cells at the foot of something higher, whose windows may lie across its outline."""
    stands = view.height_mm > STANDING_MM
    side = 2 * BESIDE_CELLS + 1
    return dilated(stands, side)


def _terms(x: Float64Array, y: Float64Array) -> Float64Array:
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
