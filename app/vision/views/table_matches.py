"""Which matches lie on the table that carries the marker: a plane close to the marker's that many of them share.

Refined views and matches -> those on the table. A marker that fills a tenth of the photograph leaves its plane's tilt
unsure by degrees, and far from it everything would be measured as if it were higher or lower, and larger or smaller.
That the table is flat and goes on beyond the sheet tells the poses what the sheet alone cannot.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.vision.model import Float64Array, MaskArray, View
from app.vision.views.features import triangulate

FLAT_MM = 3.0  # from the plane: what a table departs from flat, and what matching leaves
MAX_SLOPE = 0.12  # of the plane against the marker's, as poses by a small sheet leave it
MAX_STEP_MM = 3.0  # of the plane at the marker: a sheet on card
SHEET_MM = 1.0  # of the same: a sheet of paper, and what the poses leave
DOUBT_SD = 3.0  # of a match's height, by the poses' doubts, within which it may be on the table
MIN_ON_TABLE = 15
MIN_SHARE = 0.25  # of all matches
MAX_UNDER = 0.1  # share of all matches that may lie under the table: wrong ones do
MIN_SPREAD_MM = 50.0  # of those on the table, standard deviation along their second axis
DRAWS = 200
ROUNDS = 3


@dataclass(frozen=True, slots=True)
class TableMatches:
    """is_table: (n,) matches on the table. height_mm: the table's at the marker, under 0 for a print on card."""

    is_table: MaskArray
    height_mm: float


def matches_on_table(
    first: View,
    second: View,
    doubts: Sequence[tuple[View, View]],
    first_px: Float64Array,
    second_px: Float64Array,
) -> TableMatches | None:
    """The matches on the table; None where no plane is shared by enough of them.

    doubts: see RefinedViews. Nothing lies under a table: with much under it, the plane is another one.
    """
    if len(first_px) < MIN_ON_TABLE:
        return None
    points, doubt_mm = points_of_matches(first, second, doubts, first_px, second_px)
    near = np.abs(points[:, 2]) < FLAT_MM + DOUBT_SD * doubt_mm
    plane = _shared_plane(points[near])
    if plane is None:
        return None
    over_mm = points[:, 2] - points[:, :2] @ plane[:2] - plane[2]
    is_table = near & (np.abs(over_mm) < FLAT_MM)
    is_likely = np.mean(is_table) > MIN_SHARE and np.mean(over_mm < -2 * FLAT_MM) < MAX_UNDER
    if not is_likely:
        return None
    return TableMatches(is_table, float(plane[2]) if abs(plane[2]) > SHEET_MM else 0.0)


def points_of_matches(
    first: View,
    second: View,
    doubts: Sequence[tuple[View, View]],
    first_px: Float64Array,
    second_px: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    """(n, 3) where matches lie in the table frame, mm, and (n,) the sd of their heights that the poses leave."""
    points = triangulate(first, second, first_px, second_px)
    moved = [triangulate(*views, first_px, second_px)[:, 2] - points[:, 2] for views in doubts]
    return points, np.sqrt(np.square(moved).sum(axis=0)) if moved else np.zeros(len(points))


def _shared_plane(points: Float64Array) -> Float64Array | None:
    """(3,) slopes in x and y, and height at the marker, of a plane that enough of the points (n, 3) share."""
    xy, height = points[:, :2], points[:, 2]
    slopes = _slopes(xy, height) if len(points) >= MIN_ON_TABLE else np.empty((0, 2))
    if len(slopes) == 0:
        return None
    plane = np.append(slopes[(np.abs(height - slopes @ xy.T) < FLAT_MM).sum(axis=1).argmax()], 0.0)
    for _ in range(ROUNDS):
        chosen = np.abs(height - xy @ plane[:2] - plane[2]) < FLAT_MM
        if np.count_nonzero(chosen) < MIN_ON_TABLE:
            return None
        design = np.column_stack([xy[chosen], np.ones(np.count_nonzero(chosen))])
        plane = np.linalg.lstsq(design, height[chosen], rcond=None)[0]
    is_wide = np.linalg.eigvalsh(np.cov(xy[chosen].T))[0] > MIN_SPREAD_MM**2
    is_near = np.hypot(plane[0], plane[1]) < MAX_SLOPE and abs(plane[2]) < MAX_STEP_MM
    return plane if is_wide and is_near else None


def _slopes(xy_mm: Float64Array, height_mm: Float64Array) -> Float64Array:
    """(m, 2) slopes of planes through the marker's origin and two points each."""
    rng = np.random.default_rng(0)
    first, second = (rng.integers(len(xy_mm), size=DRAWS) for _ in range(2))
    determinant = xy_mm[first, 0] * xy_mm[second, 1] - xy_mm[first, 1] * xy_mm[second, 0]
    kept = np.abs(determinant) > MIN_SPREAD_MM**2
    first, second, determinant = first[kept], second[kept], determinant[kept]
    slopes = np.column_stack(
        [
            (height_mm[first] * xy_mm[second, 1] - height_mm[second] * xy_mm[first, 1])
            / determinant,
            (xy_mm[first, 0] * height_mm[second] - xy_mm[second, 0] * height_mm[first])
            / determinant,
        ]
    )
    return np.asarray(slopes[np.hypot(slopes[:, 0], slopes[:, 1]) < MAX_SLOPE], np.float64)
