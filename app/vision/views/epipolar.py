"""The fundamental matrix: from matches by the normalised 8-point method, from calibrated views, and the two compared.

Paper, section III.C. All points are px of ideal pinholes (features.undistort_to_pinhole). F maps a point x of the first
view to its epipolar line F x in the second: x'^T F x = 0 (eq. 4).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.core.errors import Failure
from app.vision.geometry.projective import cross_matrix, homogeneous
from app.vision.model import Float64Array, View
from app.vision.views.features import (
    ALIGNED_SIDE_PX,
    MIN_MATCHES,
    Matches,
    too_few_matches,
    undistort_to_pinhole,
)

DRAWN_MATCHES = 16  # paper, section IV.A
DRAWS = 120  # of 16; with a third of wrong matches in the food some draw is free of them with certainty over 0.99
SCORED_MATCHES = 150  # spread over all; more tell draws apart no better
# what the marker's poses may be off by, before refinement; beyond, a match is a wrong one
GATE_PX_AT_12MP = 12.0
GOOD_PX_AT_12MP = 4.0  # the same after refinement: SIFT's 0.3 px at reduced size, six times
SURE_PX_AT_12MP, SURE_MEDIANS = (
    1.6,
    3.0,
)  # of a sure match, at least and in median distances of the good ones
LONG_SIDE_12MP = 4000.0
# a plane (the board) leaves F free up to two points off it (Hartley, Zisserman, 2004, 13.3)
MIN_BESIDE_BOARD = 2


@dataclass(frozen=True, slots=True)
class Epipolar:
    """Both fundamental matrices and how well they fit.

    from_matches: (3, 3). drawn: (16,) indices of the winning draw. is_good: (n,) matches near the epipolar
    lines of the views. matches_distance_px, views_distance_px: median symmetric epipolar distance of the good matches.
    """

    from_matches: Float64Array
    drawn: NDArray[np.int64]
    is_good: NDArray[np.bool_]
    matches_distance_px: float
    views_distance_px: float


def compare_fundamentals(
    first: View, second: View, matches: Matches, rng: np.random.Generator
) -> Epipolar | Failure:
    """F from random draws of 16 good matches, half of the board, half of the food; and F from the views.

    The best draw is the one with the least bounded sum of distances over the good matches (MSAC: Torr and Zisserman,
    2000). Failure "too_few_matches".
    """
    x = undistort_to_pinhole(first, matches.first_px)
    x_second = undistort_to_pinhole(second, matches.second_px)
    from_views = fundamental_from_projections(projection_matrix(first), projection_matrix(second))
    # A photograph below the size where matches are aligned is no sharper than its pixels.
    long_side = max(first.camera.width, first.camera.height, ALIGNED_SIDE_PX)
    limit = GOOD_PX_AT_12MP * long_side / LONG_SIDE_12MP
    views_distances = symmetric_epipolar_distance_px(from_views, x, x_second)
    is_good = (views_distances < limit) | matches.is_board
    beside = np.flatnonzero(is_good & matches.is_food)
    if len(beside) < DRAWN_MATCHES // 2:  # a food without texture: what surrounds it has to help
        beside = np.flatnonzero(is_good & ~matches.is_board)
    board = np.flatnonzero(matches.is_board)
    if len(beside) < MIN_BESIDE_BOARD or len(beside) + len(board) < MIN_MATCHES:
        return too_few_matches(len(beside))
    best: tuple[float, Float64Array, NDArray[np.int64]] | None = None
    good, good_second = x[is_good], x_second[is_good]
    if len(good) > SCORED_MATCHES:
        scored = np.linspace(0, len(good) - 1, SCORED_MATCHES).astype(np.int64)
        good, good_second = good[scored], good_second[scored]
    for _ in range(DRAWS):
        some = rng.choice(beside, min(DRAWN_MATCHES // 2, len(beside)), replace=False)
        drawn = np.concatenate(
            [rng.choice(board, min(DRAWN_MATCHES - len(some), len(board)), replace=False), some]
        )
        candidate = fundamental_from_points(x[drawn], x_second[drawn])
        if candidate is None:
            continue
        distances = symmetric_epipolar_distance_px(candidate, good, good_second)
        score = float(np.minimum(distances, limit).sum())
        if best is None or score < best[0]:
            best = (score, candidate, drawn)
    if best is None:
        return too_few_matches(len(beside))
    return Epipolar(
        best[1],
        best[2],
        is_good,
        float(np.median(symmetric_epipolar_distance_px(best[1], x[is_good], x_second[is_good]))),
        float(np.median(views_distances[is_good])),
    )


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
    fundamental = fundamental_from_projections(projection_matrix(first), projection_matrix(second))
    distances = symmetric_epipolar_distance_px(
        fundamental,
        undistort_to_pinhole(first, matches.first_px),
        undistort_to_pinhole(second, matches.second_px),
    )
    return distances * LONG_SIDE_12MP / max(first.camera.width, first.camera.height)


def fundamental_from_points(x: Float64Array, x_second: Float64Array) -> Float64Array | None:
    """F (3, 3) of norm 1 by the normalised 8-point method: least squares of A f = 0 (eq. 7-8), then rank 2.

    x, x_second: (n, 2), n >= 8. None for degenerate points. Normalisation: Hartley, "In defense of the eight-point
    algorithm", 1997. Raises ValueError for fewer than 8 points.
    """
    if len(x) < MIN_MATCHES or len(x) != len(x_second):
        raise ValueError(
            f"The 8-point method needs 8 pairs, not {len(x)} and {len(x_second)} points."
        )
    transform, transform_second = _normalisation(x), _normalisation(x_second)
    if transform is None or transform_second is None:
        return None
    u, v = _apply(transform, x).T
    u_second, v_second = _apply(transform_second, x_second).T
    ones = np.ones_like(u)
    # eq. 8, one row a match
    a = np.column_stack(
        [u_second * u, u_second * v, u_second, v_second * u, v_second * v, v_second, u, v, ones]
    )
    f = np.linalg.svd(a)[2][-1].reshape(3, 3)
    left, singular, right = np.linalg.svd(f)
    rank_two = left @ np.diag([singular[0], singular[1], 0.0]) @ right
    fundamental = transform_second.T @ rank_two @ transform
    norm = float(np.linalg.norm(fundamental))
    return np.asarray(fundamental / norm, np.float64) if norm > 0 and np.isfinite(norm) else None


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


def _normalisation(x: Float64Array) -> Float64Array | None:
    """(3, 3) moves the centroid to the origin and the mean distance from it to the square root of 2."""
    centre = x.mean(axis=0)
    spread = float(np.hypot(*(x - centre).T).mean())
    if not spread > 0:
        return None
    scale = np.sqrt(2.0) / spread
    return np.array(
        [[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]]
    )


def _apply(transform: Float64Array, x: Float64Array) -> Float64Array:
    return x @ transform[:2, :2].T + transform[:2, 2]
