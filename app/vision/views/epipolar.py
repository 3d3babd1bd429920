"""Which matches lie on their epipolar lines, by the views' own fundamental matrix (paper, section III.C).

All points are px of ideal pinholes (features.undistort_to_pinhole). F maps a point x of the first view to its epipolar
line F x in the second: x'^T F x = 0 (eq. 4).
"""

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.projective import cross_matrix, homogeneous
from app.vision.model import Float64Array, View
from app.vision.views.features import ALIGNED_SIDE_PX, Matches, undistort_to_pinhole

# what the marker's poses may be off by, before refinement; beyond, a match is a wrong one
GATE_PX_AT_12MP = 12.0
GOOD_PX_AT_12MP = 4.0  # the same after refinement
# of a sure match, at least and in median distances of the good ones
SURE_PX_AT_12MP, SURE_MEDIANS = 1.6, 3.0
LONG_SIDE_12MP = 4000.0


def good_matches(
    first: View, second: View, matches: Matches
) -> tuple[NDArray[np.bool_], Float64Array]:
    """Return (n,) whether each match is the board's or lies on its epipolar line, and how far off it lies, px.

    A photograph below the size where matches are aligned is no sharper than its pixels.
    """
    long_side = max(first.camera.width, first.camera.height, ALIGNED_SIDE_PX)
    distances = _distances_px(first, second, matches)
    limit = GOOD_PX_AT_12MP * long_side / LONG_SIDE_12MP
    return (distances < limit) | matches.is_board, distances


def near_epipolar_lines(
    first: View, second: View, matches: Matches, limit_px_at_12mp: float
) -> NDArray[np.bool_]:
    """(n,) matches beside the board whose symmetric epipolar distance by the views' own F is below the limit."""
    return (_distances_px_at_12mp(first, second, matches) < limit_px_at_12mp) & ~matches.is_board


def surely_on_epipolar_lines(first: View, second: View, matches: Matches) -> NDArray[np.bool_]:
    """(n,) the same within thrice the median distance of those below GOOD_PX_AT_12MP.

    Where a cloth's pattern repeats, wrong matches lie near their lines as well, and all to one side of them.
    """
    distances = _distances_px_at_12mp(first, second, matches)
    good = (distances < GOOD_PX_AT_12MP) & ~matches.is_board
    limit = (
        max(SURE_PX_AT_12MP, SURE_MEDIANS * float(np.median(distances[good])))
        if good.any()
        else 0.0
    )
    return good & (distances < limit)


def _distances_px_at_12mp(first: View, second: View, matches: Matches) -> Float64Array:
    distances = _distances_px(first, second, matches)
    return distances * LONG_SIDE_12MP / max(first.camera.width, first.camera.height)


def _distances_px(first: View, second: View, matches: Matches) -> Float64Array:
    return symmetric_epipolar_distance_px(
        fundamental_from_projections(projection_matrix(first), projection_matrix(second)),
        undistort_to_pinhole(first, matches.first_px),
        undistort_to_pinhole(second, matches.second_px),
    )


def fundamental_from_projections(p: Float64Array, p_second: Float64Array) -> Float64Array:
    """The fundamental matrix [e']x P' P+ (eq. 5-6), norm 1; the paper prints e, it is the second view's, e' = P' C.

    p, p_second: (3, 4).
    """
    centre = np.linalg.svd(p)[2][-1]
    epipole = p_second @ centre
    fundamental = cross_matrix(epipole) @ p_second @ np.linalg.pinv(p)
    return np.asarray(fundamental / np.linalg.norm(fundamental), np.float64)


def projection_matrix(view: View) -> Float64Array:
    """P = K [R | t] (3, 4), table frame in mm to px of the pinhole (eq. 1-3)."""
    return view.camera.matrix @ np.column_stack([view.rotation, view.translation_mm])


def symmetric_epipolar_distance_px(
    fundamental: Float64Array, x: Float64Array, x_second: Float64Array
) -> Float64Array:
    """(n,) mean distance of each point to the epipolar line of its partner, px."""
    h, h_second = homogeneous(x), homogeneous(x_second)
    lines_second, lines = h @ fundamental.T, h_second @ fundamental
    algebraic = np.abs((h_second * lines_second).sum(1))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (
            algebraic * 0.5 * (1 / np.hypot(*lines_second[:, :2].T) + 1 / np.hypot(*lines[:, :2].T))
        )
    return np.asarray(np.nan_to_num(distance, nan=np.inf), np.float64)
