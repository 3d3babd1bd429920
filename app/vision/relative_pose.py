"""The two poses refined by the scene's own points: marker corners and matches fitted together.

Two Views and their good matches in -> two better Views and the sheet's bend. A marker that fills a tenth of the
photograph leaves rows of the rectified pair some px apart; matches from the whole scene bring them together. The scale
stays the marker's.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from app.vision.epipolar import GATE_PX_AT_12MP, GOOD_PX_AT_12MP, near_epipolar_lines
from app.vision.features import MIN_MATCHES, Matches, undistort_to_rays
from app.vision.model import Camera, Float64Array, View
from app.vision.pose import BEND_SD_MM, CORNER_SD_PX_AT_12MP, LONG_SIDE_12MP, OUTLIER_SD, bent_points

MATCH_SD_PX_AT_12MP = 1.0  # SIFT's 0.3 px at the reduced size in which it ran
FOCAL_SPREAD = 0.005  # prior, relative: focusing moves the lens by a few thousandths of f between two photographs
CENTRE_SPREAD = 0.003  # prior, of the long side: optical stabilisers shift the principal point by some ten px
MAX_MATCHES = 200  # spread over all; more add time, not accuracy


@dataclass(frozen=True, slots=True)
class RefinedViews:
    """first, second: with pose, focal length and principal point refined.

    bend_mm: (3,), see pose.bent_points. matches: how many took part beside the marker; 0: the marker alone.
    """

    first: View
    second: View
    bend_mm: Float64Array
    matches: int


def refine_views(first: View, second: View, matches: Matches) -> RefinedViews:
    """Both views fitted to the board's corners and to the matches near their epipolar lines, in two rounds.

    The second round keeps only the matches that the first one explains.
    """
    refined = RefinedViews(first, second, np.zeros(3), 0)
    for limit in (GATE_PX_AT_12MP, GOOD_PX_AT_12MP):
        near = near_epipolar_lines(refined.first, refined.second, matches, limit)
        if np.count_nonzero(near) < MIN_MATCHES:  # so few may be near by chance
            near = np.zeros_like(near)
        refined = fit_views(first, second, matches.first_px[near], matches.second_px[near])
    return refined


def fit_views(first: View, second: View, first_px: Float64Array, second_px: Float64Array) -> RefinedViews:
    """Maximum a posteriori of both poses, both lenses' small changes and the sheet's bend.

    first_px, second_px: (n, 2) matches beside the marker, px of the photographs. Minimises the corners' reprojection
    error and the matches' Sampson distance (Hartley and Zisserman, 2004, eq. 11.9), outliers bounded.
    """
    if len(first_px) > MAX_MATCHES:
        chosen = np.linspace(0, len(first_px) - 1, MAX_MATCHES).astype(np.int64)
        first_px, second_px = first_px[chosen], second_px[chosen]
    views = (first, second)
    rays = [undistort_to_rays(view, pixels) for view, pixels in zip(views, (first_px, second_px), strict=True)]
    corners = [undistort_to_rays(view, view.marker.corners_px) for view in views]
    focal = [float(np.sqrt(view.camera.fx * view.camera.fy)) for view in views]
    unit = max(first.camera.width, first.camera.height) / LONG_SIDE_12MP
    start = np.concatenate(
        [*(np.concatenate([np.ravel(cv2.Rodrigues(v.rotation)[0]), v.translation_mm]) for v in views), np.zeros(9)]
    )
    spread = np.concatenate([np.full(3, BEND_SD_MM), *(_lens_spread(view.camera) for view in views)])

    def residual(unknowns: Float64Array) -> Float64Array:
        points = bent_points(first.marker.spec, unknowns[12:15])
        parts = [unknowns[12:] / spread]
        poses, ideal = [], []
        for index in (0, 1):
            pose = unknowns[6 * index : 6 * index + 6]
            log_scale, *shift = unknowns[15 + 3 * index : 18 + 3 * index]
            rotation = np.asarray(cv2.Rodrigues(pose[:3])[0], np.float64)
            in_camera = points @ rotation.T + pose[3:]
            seen = (corners[index] - shift) / np.exp(log_scale)
            error_px = (in_camera[:, :2] / in_camera[:, 2:] - seen) * focal[index]
            parts.append(error_px.ravel() / (CORNER_SD_PX_AT_12MP * unit))
            poses.append((rotation, pose[3:]))
            ideal.append((rays[index] - shift) / np.exp(log_scale))
        sampson = _sampson(poses[0], poses[1], ideal[0], ideal[1]) * np.mean(focal)
        parts.append(sampson / (MATCH_SD_PX_AT_12MP * unit))
        return np.concatenate(parts)

    solved = least_squares(residual, start, loss="soft_l1", f_scale=OUTLIER_SD, x_scale="jac").x
    refined = []
    for index, view in enumerate(views):
        pose = solved[6 * index : 6 * index + 6]
        log_scale, shift_x, shift_y = solved[15 + 3 * index : 18 + 3 * index]
        camera = replace(
            view.camera,
            fx=view.camera.fx * float(np.exp(log_scale)),
            fy=view.camera.fy * float(np.exp(log_scale)),
            cx=view.camera.cx + float(shift_x) * view.camera.fx,
            cy=view.camera.cy + float(shift_y) * view.camera.fy,
        )
        rotation = np.asarray(cv2.Rodrigues(pose[:3])[0], np.float64)
        refined.append(replace(view, camera=camera, rotation=rotation, translation_mm=pose[3:]))
    return RefinedViews(refined[0], refined[1], solved[12:15], len(first_px))


def _lens_spread(camera: Camera) -> Float64Array:
    """(3,) prior spreads of log f and of the principal point's shift over f."""
    shift = CENTRE_SPREAD * max(camera.width, camera.height) / camera.fx
    return np.array([FOCAL_SPREAD, shift, shift])


def _sampson(
    pose: tuple[Float64Array, Float64Array],
    pose_second: tuple[Float64Array, Float64Array],
    x: Float64Array,
    x_second: Float64Array,
) -> Float64Array:
    """(n,) signed Sampson distance in rays' units (x / z); poses: rotation and translation, table to camera."""
    rotation = pose_second[0] @ pose[0].T
    tx, ty, tz = pose_second[1] - rotation @ pose[1]
    essential = np.array([[0.0, -tz, ty], [tz, 0.0, -tx], [-ty, tx, 0.0]]) @ rotation
    if len(x) == 0:
        return np.empty(0)
    ones = np.ones((len(x), 1))
    h, h_second = np.hstack([x, ones]), np.hstack([x_second, ones])
    lines_second, lines = h @ essential.T, h_second @ essential
    gradient = (lines_second[:, :2] ** 2).sum(1) + (lines[:, :2] ** 2).sum(1)
    return np.asarray((h_second * lines_second).sum(1) / np.sqrt(gradient), np.float64)
