"""A stereo rig from photographs of one board by both of its cameras (Zhang 2000, both cameras refined together).

Pairs of photographs taken at the same time -> StereoRig: intrinsics of each camera and the pose between them. Each
camera is calibrated alone first (calibration.py); pairs in which both see the board then fix the pose.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.calibration import (
    MAX_VIEW_RMS_FACTOR,
    MIN_VIEWS,
    Calibration,
    RejectedPhoto,
    calibrate,
    calibrated_camera,
    flat_points,
)
from app.vision.board.marker import agree_on_corners, find_marker
from app.vision.board.print_layout import CommonPoints, common_points
from app.vision.intrinsics import TOLERATED_RMS_PX
from app.vision.marker_spec import MarkerSpec
from app.vision.model import Float64Array, Photo, PhotoPair
from app.vision.rig import MAX_BASELINE_MM, MIN_BASELINE_MM, StereoRig

# of a partly covered board; the pose of a plane is well determined by twice its four corners
MIN_COMMON_POINTS = 8
RIG_ADVICE = (
    "Photograph the board ten times or so with both cameras at the same moment: from different sides, tilted by 30 to"
    " 45 degrees, near the middle and near the corners of both pictures."
)


@dataclass(frozen=True, slots=True)
class RigCalibration:
    """The rig, the rms distance of reprojected corners in px, and the indices of the pairs used.

    rejected: pairs that were left out, by the index of the pair.
    """

    rig: StereoRig
    rms_px: float
    used: tuple[int, ...]
    rejected: tuple[RejectedPhoto, ...]


def calibrate_rig(
    left: Sequence[Photo], right: Sequence[Photo], spec: MarkerSpec
) -> RigCalibration | Failure:
    """The rig whose cameras took these photographs of one board; left[i] and right[i] at the same moment.

    Failures: calibration_views_insufficient (one camera, or too few pairs that both see), rig_not_fixed (the cameras
    fit each alone, but no pose between them fits all pairs). Raises ValueError if there are not as many right
    photographs as left ones.
    """
    if len(left) != len(right):
        raise ValueError(f"{len(left)} left and {len(right)} right photographs are no pairs.")
    calibrations: list[Calibration] = []
    for name, photos in (("left", left), ("right", right)):
        alone = calibrate(photos, spec)
        if isinstance(alone, Failure):
            return Failure(alone.code, f"The {name} camera: {alone.message}", alone.advice)
        calibrations.append(alone)
    rejected = _rejected_of_either(calibrations)
    pairs = _observe(left, right, spec, rejected)
    if len(pairs) < MIN_VIEWS:
        return _insufficient(len(pairs), len(left), rejected)
    fit = _fit_rig(list(pairs.values()), spec, calibrations)
    limit_px = max(TOLERATED_RMS_PX, MAX_VIEW_RMS_FACTOR * float(np.median(fit.pair_rms_px)))
    poor = [index for index, rms in zip(pairs, fit.pair_rms_px, strict=True) if rms > limit_px]
    if poor and len(pairs) - len(poor) >= MIN_VIEWS:
        for index in poor:
            pairs.pop(index)
            rejected[index] = Failure(
                "calibration_view_poor",
                f"The board's corners are more than {limit_px:.1f} px off the other pairs' rig.",
                "Take both photographs of a pair at the same moment, of a board that does not move.",
            )
        fit = _fit_rig(list(pairs.values()), spec, calibrations)
    not_fixed = _why_not_fixed(fit, max(each.rms_px for each in calibrations))
    if not_fixed is not None:
        return not_fixed
    return RigCalibration(
        fit.rig,
        fit.rms_px,
        tuple(pairs),
        tuple(RejectedPhoto(index, why) for index, why in sorted(rejected.items())),
    )


def _why_not_fixed(fit: "_RigFit", alone_px: float) -> Failure | None:
    """Why the fit is of no rig. alone_px: rms distance of corners of the cameras calibrated each alone."""
    if fit.rms_px > max(TOLERATED_RMS_PX, MAX_VIEW_RMS_FACTOR * alone_px):
        return Failure(
            "rig_not_fixed",
            f"Each camera fits the board's corners to {alone_px:.2f} px, both together only to {fit.rms_px:.2f} px: "
            "the cameras moved against each other, or the photographs of a pair were not taken at the same moment.",
            RIG_ADVICE,
        )
    if not MIN_BASELINE_MM <= fit.rig.baseline_mm <= MAX_BASELINE_MM:
        return Failure(
            "rig_not_fixed",
            f"The cameras would be {fit.rig.baseline_mm:.2f} mm apart, which is no rig.",
            "Give the photographs of both cameras, those of the left one first.",
        )
    return None


def _rejected_of_either(calibrations: Sequence[Calibration]) -> dict[int, Failure]:
    """Pair -> why its left photograph, or else its right one, was of no use to its camera."""
    rejected: dict[int, Failure] = {}
    for name, alone in zip(("left", "right"), calibrations, strict=True):
        for photo in alone.rejected:
            failure = photo.failure
            why = Failure(failure.code, f"The {name} photograph: {failure.message}", failure.advice)
            rejected.setdefault(photo.index, why)
    return rejected


def _observe(
    left: Sequence[Photo], right: Sequence[Photo], spec: MarkerSpec, rejected: dict[int, Failure]
) -> dict[int, CommonPoints]:
    """The observations of the pairs that are not rejected; those without enough common points become rejected."""
    pairs: dict[int, CommonPoints] = {}
    for index in set(range(len(left))) - rejected.keys():
        pair = _common_points(PhotoPair(left[index], right[index]), spec)
        if isinstance(pair, Failure):
            rejected[index] = pair
        else:
            pairs[index] = pair
    return dict(sorted(pairs.items()))


def _common_points(photos: PhotoPair, spec: MarkerSpec) -> CommonPoints | Failure:
    """The points of the board that both photographs show."""
    left, right = (find_marker(photo, spec) for photo in photos.both)
    if isinstance(left, Failure):
        return left
    if isinstance(right, Failure):
        return right
    points = common_points(*agree_on_corners(photos, left, right))
    if len(points.first_px) < MIN_COMMON_POINTS:
        return Failure(
            "calibration_view_poor",
            f"Both photographs show {len(points.first_px)} points of the board, {MIN_COMMON_POINTS} are needed.",
            RIG_ADVICE,
        )
    return points


@dataclass(frozen=True, slots=True)
class _RigFit:
    """pair_rms_px: (n,) of each pair, over both photographs."""

    rig: StereoRig
    rms_px: float
    pair_rms_px: Float64Array


def _fit_rig(
    pairs: Sequence[CommonPoints], spec: MarkerSpec, calibrations: Sequence[Calibration]
) -> _RigFit:
    """Both cameras and the pose between them, refined together from each camera's own calibration."""
    left, right = (each.camera for each in calibrations)
    points = flat_points(spec)
    rms_px, k_left, d_left, k_right, d_right, rotation, translation, _, _, _, _, pair_rms = (
        cv2.stereoCalibrateExtended(
            [pair.of(points).astype(np.float32) for pair in pairs],
            [pair.first_px.astype(np.float32) for pair in pairs],
            [pair.second_px.astype(np.float32) for pair in pairs],
            left.matrix,
            np.array(left.distortion),
            right.matrix,
            np.array(right.distortion),
            # only where OpenCV makes its own first guess, which it does not here
            (left.width, left.height),
            np.eye(3),
            np.zeros(3),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS,
        )
    )
    rows = [(float(a), float(b), float(c)) for a, b, c in rotation]
    x, y, z = (float(value) for value in np.ravel(translation))
    rig = StereoRig(
        calibrated_camera((left.width, left.height), k_left, d_left),
        calibrated_camera((right.width, right.height), k_right, d_right),
        (rows[0], rows[1], rows[2]),
        (x, y, z),
    )
    by_pair = np.sqrt(np.mean(np.square(pair_rms.reshape(len(pairs), 2)), axis=1))
    return _RigFit(rig, float(rms_px), by_pair)


def _insufficient(count: int, given: int, rejected: Mapping[int, Failure]) -> Failure:
    reasons = "".join(
        f" Pair {index + 1}: {why.message}" for index, why in sorted(rejected.items())[:3]
    )
    return Failure(
        "calibration_views_insufficient",
        f"The rig cannot be calibrated: both photographs show the board in {count} of {given} pairs, at least "
        f"{MIN_VIEWS} are needed.{reasons}",
        RIG_ADVICE,
    )
