"""The camera of each photograph: intrinsics given or from EXIF, and its pose over the marker.

Marker corners (px) of both views + a given camera or the photograph's own focal length -> two Views in the table frame,
mm. Refining the relative pose by the scene's own points is left to epipolar.py.
"""

import math
from collections.abc import Sequence

import numpy as np

from app.core.errors import Failure
from app.vision.board.pose import fit_board
from app.vision.board.print_layout import common_points, shortest_side_px
from app.vision.intrinsics import Camera, adapt_camera
from app.vision.model import (
    EstimateOptions,
    Float64Array,
    MarkerObservation,
    Photo,
    PhotoPair,
    View,
)

# CIPA DCG-001: the 35 mm equivalent focal length goes by the diagonal
DIAGONAL_35MM = math.hypot(36.0, 24.0)
DEFAULT_FOCAL_35MM = 28.0  # the main camera of most phones, where EXIF tells nothing
# below, 0.3 px of disparity noise passes 10 mm of depth at 400 mm (CONVENTIONS.md, "Baseline")
MIN_VIEW_ANGLE_DEG = 1.5
MAX_VIEW_ANGLE_DEG = 45.0  # beyond, the two views show different sides of a food and hardly match
# of the shortest square in px; detected corners leave 0.003, another camera's file 0.05
MAX_RMS_SQUARES = 0.03
NOISE_RMS_PX = 0.4  # that noise alone leaves at the corners of small squares
MAX_BEND_MM = 5.0  # at the board's edge; bent further, heights over the sheet mean little
SAME_CORNERS_PX = 0.01  # no two exposures by hand agree to a hundredth of a pixel
SAMPLE_ROWS = 64  # one row of so many is compared first


def camera_from_exif(photo: Photo) -> Camera:
    """A pinhole with the focal length that EXIF tells (source "exif"), or a common phone's (source "board").

    f_px = f_35 / 43.27 mm x the diagonal in px (CIPA DCG-001); principal point in the middle, no distortion.
    """
    height, width = photo.pixels_bgr.shape[:2]
    focal_px = (photo.focal_35mm or DEFAULT_FOCAL_35MM) / DIAGONAL_35MM * math.hypot(width, height)
    return Camera(
        width,
        height,
        focal_px,
        focal_px,
        (width - 1) / 2,
        (height - 1) / 2,
        source="exif" if photo.focal_35mm else "board",
    )


def estimate_views(
    pair: PhotoPair,
    observations: tuple[MarkerObservation, MarkerObservation],
    options: EstimateOptions,
    *,
    is_stereo: bool = True,
) -> tuple[View, View] | Failure:
    """Camera and pose of both photographs from the marker's corners, which must agree (marker.agree_on_corners).

    is_stereo: whether the baseline must be one for stereo. A View's rms_px is against the bent sheet.
    Failures: camera_mismatch, same_photograph, pose_unreliable; for stereo baseline_too_small, baseline_too_large.
    """
    photos = pair.both
    if _is_same_photograph(photos, observations):
        return Failure(
            "same_photograph",
            "Both photographs are the same one.",
            "Take one photograph from the left of the meal and one from the right, about a hand's width apart.",
        )
    views = _fitted_views(photos, observations, options)
    if isinstance(views, Failure):
        return views
    left, right = views
    too_near_or_far = _baseline_failure(left, right) if is_stereo else None
    return (left, right) if too_near_or_far is None else too_near_or_far


def estimate_view(
    photo: Photo, observation: MarkerObservation, options: EstimateOptions
) -> View | Failure:
    """The same of one photograph. Failures: camera_mismatch, pose_unreliable."""
    views = _fitted_views((photo,), (observation,), options)
    return views if isinstance(views, Failure) else views[0]


def _fitted_views(
    photos: Sequence[Photo], observations: Sequence[MarkerObservation], options: EstimateOptions
) -> list[View] | Failure:
    cameras: list[Camera] = []
    for photo in photos:
        if options.camera is None:
            cameras.append(camera_from_exif(photo))
            continue
        adapted = adapt_camera(options.camera, photo.pixels_bgr.shape[1], photo.pixels_bgr.shape[0])
        if isinstance(adapted, Failure):
            return adapted
        cameras.append(adapted)
    fit = fit_board(cameras, observations)
    if fit is None:
        return _unreliable("no camera position above the table explains the marker's corners")
    for name, rms, observation in zip(("left", "right"), fit.rms_px, observations, strict=False):
        limit = max(MAX_RMS_SQUARES * shortest_side_px(observation), NOISE_RMS_PX)
        if rms > limit:
            return _unreliable(
                f"the marker's corners in the {name} photograph fit to {rms:.1f} px only, {limit:.1f} px is the limit"
            )
    bend_mm = float(np.abs(fit.bend_mm).max())
    if bend_mm > MAX_BEND_MM:
        return _unreliable(
            f"the marker seems bent by {bend_mm:.0f} mm, more than {MAX_BEND_MM:g} mm"
        )
    return [
        View(photo, camera, observation, rotation, translation_mm, rms)
        for photo, camera, observation, (rotation, translation_mm), rms in zip(
            photos, fit.cameras, observations, fit.poses, fit.rms_px, strict=True
        )
    ]


def view_angle_deg(left: View, right: View) -> float:
    """Angle between the two lines of sight from the board's middle to the cameras, degrees."""
    a, b = left.centre_mm, right.centre_mm
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))


def _unreliable(reason: str) -> Failure:
    return Failure(
        "pose_unreliable",
        f"The camera's position cannot be trusted: {reason}.",
        "Lay the marker flat; check that the announced marker and the camera file are the right ones.",
    )


def _sees(view: View, point_mm: Float64Array) -> bool:
    """Return whether the line through the camera and the point (3,), table frame, mm, meets the photograph.

    The point may lie behind the camera.
    """
    x, y, z = view.rotation @ point_mm + view.translation_mm
    camera = view.camera
    column, row = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return bool(0 <= column < camera.width and 0 <= row < camera.height)


def _baseline_failure(left: View, right: View) -> Failure | None:
    angle = view_angle_deg(left, right)
    if angle < MIN_VIEW_ANGLE_DEG:
        return Failure(
            "baseline_too_small",
            f"The two photographs were taken only {angle:.1f} degrees apart; {MIN_VIEW_ANGLE_DEG:g} are needed.",
            "Move the phone by about a hand's width to the side between the two photographs.",
        )
    # Where one camera stands in the other's photograph, rows along the baseline would have to run through that point.
    if _sees(left, right.centre_mm) or _sees(right, left.centre_mm):
        return Failure(
            "baseline_too_small",
            "The second photograph was taken from nearer or farther away, not from the side.",
            "Keep the distance and move the phone by about a hand's width to the side between the two photographs.",
        )
    if angle > MAX_VIEW_ANGLE_DEG:
        return Failure(
            "baseline_too_large",
            f"The two photographs were taken {angle:.0f} degrees apart; {MAX_VIEW_ANGLE_DEG:g} are the most.",
            "Move the phone by only about a hand's width to the side between the two photographs.",
        )
    return None


def _is_same_photograph(
    photos: tuple[Photo, Photo], observations: tuple[MarkerObservation, MarkerObservation]
) -> bool:
    common = common_points(*observations)
    if len(common.first_px) and np.abs(common.first_px - common.second_px).max() < SAME_CORNERS_PX:
        return True
    first, second = photos[0].pixels_bgr, photos[1].pixels_bgr
    # two photographs differ there already: all pixels are compared of copies alone
    some = slice(None, None, SAMPLE_ROWS)
    return np.array_equal(first[some], second[some]) and np.array_equal(first, second)
