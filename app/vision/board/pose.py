"""Where the cameras stood over the marker: poses of one or more views from the corners of the printed sheet.

Cameras and observations in -> rotations, translations (mm), and for cameras that are only guessed a better focal
length.
The sheet is taken as slightly bent, since paper is: a bend of one millimetre moves corners by a pixel, and a flat model
would turn that into five percent of focal length. Intrinsics themselves: camera.py.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.vision.board.print_layout import print_points_mm
from app.vision.geometry.robust_fit import minimise
from app.vision.intrinsics import Camera
from app.vision.marker_spec import MarkerSpec
from app.vision.model import Float64Array, MarkerObservation

# the detector's 0.1 px, and what bend and distortion of higher order leave
CORNER_SD_PX_AT_12MP = 0.3
LONG_SIDE_12MP = 4000.0
BEND_SD_MM = 1.0  # prior: height of the sheet's edges over its middle, paper on a table
# prior, relative: EXIF rounds to whole mm, makers give the lens's nominal value
FOCAL_SPREAD_EXIF = 0.08
FOCAL_SPREAD_UNKNOWN = 0.25  # prior, relative: main cameras of phones lie between 22 and 35 mm
RADIAL_SPREAD = 0.1  # prior of k1: phones correct most of their distortion themselves


@dataclass(frozen=True, slots=True)
class BoardFit:
    """Views of one sheet, fitted together.

    poses: of each, rotation (3, 3) and translation (3,) mm, table to camera. bend_mm: (3,), see bent_points.
    rms_px: of each view's corners against the bent sheet.
    """

    cameras: tuple[Camera, ...]
    poses: tuple[tuple[Float64Array, Float64Array], ...]
    bend_mm: Float64Array
    rms_px: tuple[float, ...]


def board_points(spec: MarkerSpec) -> Float64Array:
    """(n, 3) print_points_mm in the table frame, mm: all at z = thick_mm."""
    return _board_points(spec).copy()


@functools.lru_cache(maxsize=8)
def _board_points(spec: MarkerSpec) -> Float64Array:
    """As board_points, which the fits ask for a thousand times a pair."""
    points = print_points_mm(spec)
    return np.column_stack([points, np.full(len(points), spec.thick_mm)])


def bent_points(spec: MarkerSpec, bend_mm: Float64Array) -> Float64Array:
    """board_points on a sheet that bends by z = thick_mm + a u^2 + b v^2 + c u v.

    u, v: x, y over half the board's longer side. bend_mm: (3,), a, b, c in mm.
    """
    points = board_points(spec)
    u, v = points[:, :2].T / (max(spec.width_mm, spec.height_mm) / 2)
    points[:, 2] += bend_mm[0] * u**2 + bend_mm[1] * v**2 + bend_mm[2] * u * v
    return points


def project(camera: Camera, points_table: Float64Array, pose: Float64Array) -> Float64Array:
    """(n, 3) mm -> (n, 2) px with pose (6,): rotation vector, translation in mm; table to camera."""
    projected, _ = cv2.projectPoints(
        points_table, pose[:3], pose[3:], camera.matrix, np.array(camera.distortion)
    )
    return np.asarray(projected, np.float64).reshape(-1, 2)


def solve_pose(
    camera: Camera, observation: MarkerObservation
) -> tuple[Float64Array, Float64Array, float] | None:
    """Rotation (3, 3) and translation (3,) mm, table to camera, of a flat sheet, and the corners' rms in px.

    Of a plane's two poses (IPPE: Collins and Bartoli, 2014) the one above the table that fits better once refined;
    None if there is none.
    """
    points = observation.seen_of(board_points(observation.spec))
    raised = np.array([0.0, 0.0, observation.spec.thick_mm])
    # IPPE wants its plane at z = 0: it gives the print's pose, from which the table's origin lies `raised` below.
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points - raised,
        observation.corners_px,
        camera.matrix,
        np.array(camera.distortion),
        flags=cv2.SOLVEPNP_IPPE,
    )

    corner_sd_px = _corner_sd_px(camera)

    def residual(pose: Float64Array) -> Float64Array:
        return (project(camera, points, pose) - observation.corners_px).ravel() / corner_sd_px

    best: tuple[Float64Array, Float64Array, float] | None = None
    for rvec, tvec in zip(turns, shifts, strict=True):
        start = np.concatenate([np.ravel(rvec), np.ravel(tvec) - cv2.Rodrigues(rvec)[0] @ raised])
        if not np.isfinite(start).all() or start[5] <= 0:
            continue
        pose, _ = minimise(residual, start)
        rotation = np.asarray(cv2.Rodrigues(pose[:3])[0], np.float64)
        rms = _rms_px(residual(pose) * corner_sd_px)
        if _is_above_table(rotation, pose[3:]) and (best is None or rms < best[2]):
            best = (rotation, pose[3:], rms)
    return best


def fit_board(
    cameras: Sequence[Camera], observations: Sequence[MarkerObservation]
) -> BoardFit | None:
    """Each view's pose, the sheet's bend and, unless a camera is "given", focal length and k1: maximum a posteriori.

    Guessed cameras that are equal (same size, same EXIF) stay equal: one phone. Principal point and further
    distortion stay as they are; a board that fills a tenth of the photograph cannot tell them. None: no pose explains
    the corners.
    """
    poses = [solve_pose(camera, seen) for camera, seen in zip(cameras, observations, strict=True)]
    starts = [
        np.concatenate([np.ravel(cv2.Rodrigues(pose[0])[0]), pose[1]])
        for pose in poses
        if pose is not None
    ]
    if len(starts) < len(cameras):
        return None
    count = len(cameras)
    bend_at = 6 * count  # in the unknowns: poses, bend, then (log scale of f, k1) a lens
    lenses = 1 if all(camera == cameras[0] for camera in cameras) else count
    lens_at = [bend_at + 3 + (2 * index if lenses > 1 else 0) for index in range(count)]
    first = np.concatenate([*starts, np.zeros(3 + 2 * lenses)])
    corner_sd = [_corner_sd_px(camera) for camera in cameras]
    spreads = np.concatenate(
        [np.full(3, BEND_SD_MM), *(_lens_spread(camera) for camera in cameras[:lenses])]
    )
    # A given camera keeps its lens: these unknowns are left out, and stay zero.
    is_free = np.concatenate([np.full(bend_at + 3, True), spreads[3:] > 0])

    def unpack(free: Float64Array) -> Float64Array:
        unknowns = np.zeros_like(first)
        unknowns[is_free] = free
        return unknowns

    def corner_residual(index: int, unknowns: Float64Array) -> Float64Array:
        camera = _scaled_lens(cameras[index], *unknowns[lens_at[index] : lens_at[index] + 2])
        seen = observations[index]
        points = seen.seen_of(bent_points(seen.spec, unknowns[bend_at : bend_at + 3]))
        return (
            project(camera, points, unknowns[6 * index : 6 * index + 6]) - seen.corners_px
        ).ravel()

    def residual(free: Float64Array) -> Float64Array:
        unknowns = unpack(free)
        prior = unknowns[bend_at:][is_free[bend_at:]] / spreads[is_free[bend_at:]]
        return np.concatenate(
            [
                prior,
                *(corner_residual(index, unknowns) / corner_sd[index] for index in range(count)),
            ]
        )

    solved = unpack(minimise(residual, first[is_free])[0])
    placed = [
        (np.asarray(cv2.Rodrigues(solved[at : at + 3])[0], np.float64), solved[at + 3 : at + 6])
        for at in range(0, bend_at, 6)
    ]
    if not all(_is_above_table(rotation, translation) for rotation, translation in placed):
        return None
    return BoardFit(
        cameras=tuple(
            _scaled_lens(camera, *solved[at : at + 2])
            for camera, at in zip(cameras, lens_at, strict=True)
        ),
        poses=tuple(placed),
        bend_mm=solved[bend_at : bend_at + 3],
        rms_px=tuple(_rms_px(corner_residual(index, solved)) for index in range(count)),
    )


def _lens_spread(camera: Camera) -> Float64Array:
    """(2,) prior spreads of log f and k1; 0 where the camera is given and nothing is to be refined."""
    if camera.source == "given":
        return np.zeros(2)
    return np.array(
        [FOCAL_SPREAD_EXIF if camera.source == "exif" else FOCAL_SPREAD_UNKNOWN, RADIAL_SPREAD]
    )


def _scaled_lens(camera: Camera, log_scale: float, radial: float) -> Camera:
    k1, k2, p1, p2, k3 = camera.distortion
    scale = float(np.exp(log_scale))
    distortion = (k1 + float(radial), k2, p1, p2, k3)
    return replace(camera, fx=camera.fx * scale, fy=camera.fy * scale, distortion=distortion)


def _is_above_table(rotation: Float64Array, translation_mm: Float64Array) -> bool:
    """Whether the camera looks at the printed side: its centre has z > 0, and the board is in front of it."""
    return bool((rotation.T @ translation_mm)[2] < 0 and translation_mm[2] > 0)


def _corner_sd_px(camera: Camera) -> float:
    return CORNER_SD_PX_AT_12MP * max(camera.width, camera.height) / LONG_SIDE_12MP


def _rms_px(residual: Float64Array) -> float:
    """Root mean square distance of corners; residual: (2 n,) of x, y, px."""
    return float(np.sqrt(2.0 * np.mean(residual**2)))
