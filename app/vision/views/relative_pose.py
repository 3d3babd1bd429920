"""Poses and lenses refined by the whole scene: marker corners and matches fitted together, maximum a posteriori.

Two Views and their good matches in -> two better Views and the sheet's bend. A marker that fills a tenth of the
photograph leaves rows of the rectified pair some px apart and tells focal length and distortion poorly; matches from
the whole scene bring rows together and tell more of the lens. The scale stays the marker's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import cv2
import numpy as np

from app.vision.board.camera import camera_from_exif
from app.vision.board.pose import (
    BEND_SD_MM,
    CORNER_SD_PX_AT_12MP,
    FOCAL_SPREAD_EXIF,
    FOCAL_SPREAD_UNKNOWN,
    LONG_SIDE_12MP,
    RADIAL_SPREAD,
    bent_points,
)
from app.vision.geometry.projective import cross_matrix, homogeneous
from app.vision.geometry.robust_fit import minimise
from app.vision.intrinsics import Camera
from app.vision.model import Float64Array, View
from app.vision.views.epipolar import (
    GATE_PX_AT_12MP,
    GOOD_PX_AT_12MP,
    near_epipolar_lines,
    surely_on_epipolar_lines,
)
from app.vision.views.features import MIN_MATCHES, Matches
from app.vision.views.table_matches import TableMatches, matches_on_table

MATCH_SD_PX_AT_12MP = 1.5  # alignment leaves 0.3 px; the rest is what lenses do beyond their model, far from the middle
FOCAL_SPREAD = 0.005  # prior, relative: focusing moves the lens by a few thousandths of f between two photographs
# Prior, of the long side, about a given centre or the middle: optical stabilisers shift the principal point by some ten
# px; more freedom trades it for focal length.
CENTRE_SPREAD = 0.003
RADIAL_SPREAD_4TH = 0.1  # prior of k2, which phones have beside k1, often of the other sign
RADIAL_CHANGE = 0.001  # of k1 and k2 between two photographs by one lens
TABLE_SD_MM = 1.0  # of a table's height about a plane
# spread over all; more would make poses surer than they are
MAX_MATCHES = 200
# a view: log of f over its guess, the principal point's shift over f in x and y, k1, k2
LENS_UNKNOWNS = 5


@dataclass(frozen=True, slots=True)
class RefinedViews:
    """first, second: with pose, focal length and principal point refined.

    bend_mm: (3,), see pose.bent_points. matches: how many took part beside the marker; 0: the marker alone. doubts:
    the views one standard deviation along each axis of their covariance; none before a fit.
    """

    first: View
    second: View
    bend_mm: Float64Array
    matches: int
    doubts: tuple[tuple[View, View], ...] = ()


def refine_views(first: View, second: View, matches: Matches) -> RefinedViews:
    """Both views fitted to the board's corners and to the matches near their epipolar lines, in three rounds.

    Each round keeps only the matches that the one before explains. At last, those on the table stay on it.
    """
    refined = RefinedViews(first, second, np.zeros(3), 0)
    pixels = np.empty((0, 2)), np.empty((0, 2))
    for is_near in (
        partial(near_epipolar_lines, limit_px_at_12mp=GATE_PX_AT_12MP),
        partial(near_epipolar_lines, limit_px_at_12mp=GOOD_PX_AT_12MP),
        surely_on_epipolar_lines,
    ):
        near = is_near(refined.first, refined.second, matches)
        if np.count_nonzero(near) < MIN_MATCHES:  # so few may be near by chance
            near = np.zeros_like(near)
        pixels = matches.first_px[near], matches.second_px[near]
        refined = fit_views(refined.first, refined.second, *pixels, (first, second))
    table = matches_on_table(refined.first, refined.second, refined.doubts, *pixels)
    if table is None:
        return refined
    return fit_views(refined.first, refined.second, *pixels, (first, second), table)


def fit_views(
    first: View,
    second: View,
    first_px: Float64Array,
    second_px: Float64Array,
    guesses: tuple[View, View] | None = None,
    table: TableMatches | None = None,
) -> RefinedViews:
    """Maximum a posteriori of both poses, both lenses and the sheet's bend, from these views on.

    first_px, second_px: (n, 2) matches beside the marker, px of the photographs. guesses: the views whose cameras, if
    "given", the priors stand on; None: the same. table: those matches that stay on the table. A camera that is not
    given has its prior on what EXIF tells, a spread of 8 % about it, and k1 and k2 free. Minimises the corners'
    reprojection error and the matches' Sampson distance, outliers bounded.
    """
    if len(first_px) > MAX_MATCHES:
        chosen = np.linspace(0, len(first_px) - 1, MAX_MATCHES).astype(np.int64)
        first_px, second_px = first_px[chosen], second_px[chosen]
        table = None if table is None else replace(table, is_table=table.is_table[chosen])
    views = (first, second)
    bases = tuple(_prior_camera(view) for view in guesses or views)
    matched = [
        _to_rays(camera, pixels)
        for camera, pixels in zip(bases, (first_px, second_px), strict=True)
    ]
    corners = [
        _to_rays(base, view.required_marker.corners_px)
        for base, view in zip(bases, views, strict=True)
    ]
    unit = max(first.camera.width, first.camera.height) / LONG_SIDE_12MP
    prior = _lens_prior(bases[0], bases[1])
    lenses = [_lens_of(view.camera, base) for view, base in zip(views, bases, strict=True)]
    start = np.concatenate([*map(_unknown_pose, views, lenses), np.zeros(3), *lenses])

    @lru_cache(maxsize=4)  # most of a fit's steps change another unknown than a view's lens
    def ideal_rays(index: int, *lens: float) -> tuple[Float64Array, Float64Array]:
        corner_rays, match_rays = (
            undistort_by_lens(rays[index], np.array(lens)) for rays in (corners, matched)
        )
        return corner_rays, match_rays

    def residual(unknowns: Float64Array) -> Float64Array:
        points = bent_points(first.required_marker.spec, unknowns[12:15])
        parts = [unknowns[12:15] / BEND_SD_MM, prior @ unknowns[15:]]
        poses, ideal, focal_px = [], [], []
        for index in (0, 1):
            rotation, translation_mm, lens = _pose_and_lens(unknowns, index)
            corner_rays, match_rays = ideal_rays(index, *lens.tolist())
            in_camera = views[index].required_marker.seen_of(points) @ rotation.T + translation_mm
            error = in_camera[:, :2] / in_camera[:, 2:] - corner_rays
            # In pixels of the lens tried: rays of a longer one lie closer, and it would fit better by that alone.
            focal_px.append(bases[index].fx * np.exp(lens[0]))
            parts.append(error.ravel() * (focal_px[index] / (CORNER_SD_PX_AT_12MP * unit)))
            poses.append((rotation, translation_mm))
            ideal.append(match_rays)
        sampson = sampson_distance(_essential_matrix(poses[0], poses[1]), ideal[0], ideal[1])
        parts.append(sampson * (sum(focal_px) / 2 / (MATCH_SD_PX_AT_12MP * unit)))
        if table is not None:
            parts.append(_off_table(poses, ideal, table, focal_px[1], MATCH_SD_PX_AT_12MP * unit))
        return np.concatenate(parts)

    def views_at(unknowns: Float64Array) -> tuple[View, View]:
        moved = []
        for index, (view, base) in enumerate(zip(views, bases, strict=True)):
            rotation, translation_mm, lens = _pose_and_lens(unknowns, index)
            camera = camera_with_lens(base, lens)
            moved.append(
                replace(view, camera=camera, rotation=rotation, translation_mm=translation_mm)
            )
        return moved[0], moved[1]

    solved, normal = minimise(residual, start)
    spread = np.linalg.cholesky(np.linalg.inv(normal)).T
    doubts = tuple(views_at(solved + axis) for axis in spread)
    return RefinedViews(*views_at(solved), solved[12:15], len(first_px), doubts)


def _unknown_pose(view: View, lens: Float64Array) -> Float64Array:
    """(6,) rotation vector, and the translation over the focal length's factor.

    A board seen from straight above stays in place when distance and focal length grow together; in these unknowns
    that is one of them alone, and the search runs straight along it.
    """
    return np.concatenate(
        [np.ravel(cv2.Rodrigues(view.rotation)[0]), view.translation_mm / np.exp(lens[0])]
    )


def _pose_and_lens(
    unknowns: Float64Array, index: int
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Rotation (3, 3), translation (3,) mm and lens (5,) of a view."""
    pose = unknowns[6 * index : 6 * index + 6]
    lens = unknowns[15 + LENS_UNKNOWNS * index : 15 + LENS_UNKNOWNS * (index + 1)]
    return np.asarray(cv2.Rodrigues(pose[:3])[0], np.float64), pose[3:] * np.exp(lens[0]), lens


def _prior_camera(view: View) -> Camera:
    """The camera as it was before any fit: as given, or as EXIF tells it, without distortion."""
    return view.camera if view.camera.source == "given" else camera_from_exif(view.photo)


def _to_rays(camera: Camera, pixels: Float64Array) -> Float64Array:
    """(n, 2) px -> (n, 2) x / z, y / z by this camera, whose own distortion is taken off."""
    if len(pixels) == 0:
        return np.empty((0, 2))
    if not any(camera.distortion):
        return (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    ideal = cv2.undistortPoints(
        np.ascontiguousarray(pixels)[:, None], camera.matrix, np.array(camera.distortion)
    )
    return np.asarray(ideal, np.float64).reshape(-1, 2)


def undistort_by_lens(rays: Float64Array, lens: Float64Array) -> Float64Array:
    """(n, 2) rays by the guessed camera -> by the camera with this lens, (5,): shifted, scaled, k1 and k2 taken off."""
    moved = (rays - lens[1:3]) / np.exp(lens[0])
    if lens[3] == 0.0 and lens[4] == 0.0:
        return np.asarray(moved, np.float64)
    square = (moved**2).sum(axis=1)
    ideal_square = square
    for _ in range(4):  # r = r_ideal (1 + k1 r_ideal^2 + k2 r_ideal^4), solved by iteration
        factor = 1.0 + lens[3] * ideal_square + lens[4] * ideal_square**2
        ideal_square = square / factor**2
    return np.asarray(moved / factor[:, None], np.float64)


def _lens_of(camera: Camera, base: Camera) -> Float64Array:
    """(5,) how a camera's lens differs from its guess."""
    shift = [(camera.cx - base.cx) / base.fx, (camera.cy - base.cy) / base.fy]
    return np.array(
        [
            np.log(camera.fx / base.fx),
            *shift,
            *np.subtract(camera.distortion[:2], base.distortion[:2]),
        ]
    )


def camera_with_lens(base: Camera, lens: Float64Array) -> Camera:
    """The camera that differs from its guess by the lens, (5,)."""
    scale = float(np.exp(lens[0]))
    k1, k2, p1, p2, k3 = base.distortion
    return replace(
        base,
        fx=base.fx * scale,
        fy=base.fy * scale,
        cx=base.cx + float(lens[1]) * base.fx,
        cy=base.cy + float(lens[2]) * base.fy,
        distortion=(k1 + float(lens[3]), k2 + float(lens[4]), p1, p2, k3),
    )


def _lens_prior(first: Camera, second: Camera) -> Float64Array:
    """(10, 10) whose product with both lenses' differences from their guesses is what the priors expect to be normal.

    Two guessed cameras that are equal are one phone's: they share what EXIF leaves open, and differ by focusing.
    """
    is_given = first.source == "given"
    rows = []
    for index, camera in enumerate((first, second)):
        for axis in (1, 2):
            row = np.zeros(2 * LENS_UNKNOWNS)
            row[LENS_UNKNOWNS * index + axis] = camera.fx / (
                CENTRE_SPREAD * max(camera.width, camera.height)
            )
            rows.append(row)
    focal_spread = FOCAL_SPREAD_EXIF if first.source == "exif" else FOCAL_SPREAD_UNKNOWN
    for at, own, change in (
        (0, focal_spread, FOCAL_SPREAD),
        (3, RADIAL_SPREAD, RADIAL_CHANGE),
        (4, RADIAL_SPREAD_4TH, RADIAL_CHANGE),
    ):
        common, difference = np.zeros(2 * LENS_UNKNOWNS), np.zeros(2 * LENS_UNKNOWNS)
        if not is_given and first == second:
            common[[at, LENS_UNKNOWNS + at]] = 0.5 / own
            difference[[at, LENS_UNKNOWNS + at]] = np.array([1.0, -1.0]) / (np.sqrt(2.0) * change)
        else:
            spread = change if is_given else own
            common[at] = difference[LENS_UNKNOWNS + at] = 1.0 / spread
        rows += [common, difference]
    return np.array(rows)


def _off_table(
    poses: Sequence[tuple[Float64Array, Float64Array]],
    rays: Sequence[Float64Array],
    table: TableMatches,
    focal_px: float,
    sd_px: float,
) -> Float64Array:
    """(m,) how far matches on the table lie from its height, in standard deviations: of matching and of its flatness.

    Measured along the epipolar line in the second view, the direction that Sampson's distance leaves free.
    """
    (rotation, translation), (rotation_second, translation_second) = poses
    centre = -rotation.T @ translation
    x, x_second = rays[0][table.is_table], rays[1][table.is_table]
    sight = homogeneous(x) @ rotation
    seen = []
    for height_mm in (table.height_mm, table.height_mm + TABLE_SD_MM):
        points = centre + sight * ((height_mm - centre[2]) / sight[:, 2])[:, None]
        in_camera = points @ rotation_second.T + translation_second
        seen.append(in_camera[:, :2] / in_camera[:, 2:])
    step = seen[1] - seen[0]
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-9)
    along = ((x_second - seen[0]) * step).sum(axis=1) / length
    return np.asarray(along * focal_px / np.hypot(sd_px, length * focal_px), np.float64)


def sampson_distance(
    essential: Float64Array, x: Float64Array, x_second: Float64Array
) -> Float64Array:
    """(n,) signed Sampson distance (Hartley and Zisserman, 2004, eq. 11.9) in rays' units, x / z.

    essential: (3, 3), x_second^T E x = 0. x, x_second: (n, 2) rays of the first and the second view.
    """
    if len(x) == 0:
        return np.empty(0)
    h, h_second = homogeneous(x), homogeneous(x_second)
    lines_second, lines = h @ essential.T, h_second @ essential
    gradient = (lines_second[:, :2] ** 2).sum(1) + (lines[:, :2] ** 2).sum(1)
    return np.asarray((h_second * lines_second).sum(1) / np.sqrt(gradient), np.float64)


def _essential_matrix(
    pose: tuple[Float64Array, Float64Array], pose_second: tuple[Float64Array, Float64Array]
) -> Float64Array:
    """(3, 3) from two poses, rotation and translation, table to camera."""
    rotation = pose_second[0] @ pose[0].T
    return cross_matrix(pose_second[1] - rotation @ pose[1]) @ rotation
