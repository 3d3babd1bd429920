"""The paper's fundamental matrix, from sixteen matches (section III.C, IV.A), and its rectification (eq. 9).

Matches, px of ideal pinholes -> F, x'^T F x = 0 (eq. 4), and the homographies that align its epipolar lines.
"""

import numpy as np

from app.vision.geometry.projective import cross_matrix, homogeneous, map_points
from app.vision.model import Float64Array
from app.vision.views.features import MIN_MATCHES

DRAWN_MATCHES = 16  # paper, section IV.A


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
    return fundamental / norm if norm > 0 and np.isfinite(norm) else None


def rectify_by_fundamental(
    fundamental: Float64Array, x: Float64Array, x_second: Float64Array, size: tuple[int, int]
) -> tuple[Float64Array, Float64Array] | None:
    """H = G R T of the first view (eq. 9) and H' of the second with least sum of d(H x, H' x')^2 (section IV.B).

    fundamental: (3, 3), x'^T F x = 0. x, x_second: (n, 2) px. size: (width, height). The second and third rows of H'
    are those of H [e]x F^T, which align its rows with H's (Hartley and Zisserman, 2004, result 11.3, views exchanged);
    the first row is free and solves the least squares. None where the epipole lies in the image, which nothing helps.
    """
    epipole = np.linalg.svd(fundamental)[2][-1]
    middle = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    if _is_in_image(epipole, size):
        return None
    homography = epipole_to_infinity(epipole, middle)
    rows = homography @ cross_matrix(epipole) @ fundamental.T
    second_points = homogeneous(x_second)
    weights = second_points @ rows[2]
    target = map_points(homography, x)[:, 0]
    free_row = np.linalg.lstsq(second_points / weights[:, None], target, rcond=None)[0]
    second = np.stack([free_row, rows[1], rows[2]])
    return homography, second / np.linalg.norm(second)


def epipole_to_infinity(epipole: Float64Array, middle: Float64Array) -> Float64Array:
    """G R T (eq. 9): middle to the origin (T), the epipole to the x-axis (R) and from there to (1, 0, 0) (G).

    epipole: (3,) homogeneous px. middle: (2,) px.
    """
    translation = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, 1.0]])
    moved = translation @ epipole
    length = float(np.hypot(moved[0], moved[1]))
    # Either half of the x-axis will do; the nearer one leaves the image the right way up.
    cosine, sine = moved[:2] / length * (1.0 if moved[0] >= 0 else -1.0)
    rotation = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    on_axis = rotation @ moved
    # Its last row begins with -1 over the focal length.
    to_infinity = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-on_axis[2] / on_axis[0], 0.0, 1.0]])
    return np.asarray(to_infinity @ rotation @ translation, np.float64)


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


def _is_in_image(epipole: Float64Array, size: tuple[int, int]) -> bool:
    if abs(epipole[2]) < np.finfo(np.float64).eps * float(np.abs(epipole).max()):
        return False
    x, y = epipole[:2] / epipole[2]
    return bool(0 <= x < size[0] and 0 <= y < size[1])
