"""The views of a stereo rig: cameras and relative pose as calibrated, the table frame from the scene.

Two photographs and their rig -> two Views over the table that was found; then the relative pose adjusted by the
scene's own matches within what a calibration leaves open, with its doubts. A rig of known poses is too rough to match
by densely: its pose is adjusted by matches first.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Literal

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.pose import LONG_SIDE_12MP
from app.vision.geometry.projective import cross_matrix
from app.vision.geometry.robust_fit import minimise
from app.vision.intrinsics import Camera
from app.vision.model import Float64Array, Int64Array, MaskArray, Photo, PhotoPair, View
from app.vision.rig import StereoRig, adapt_rig
from app.vision.views.epipolar import (
    GATE_PX_AT_12MP,
    near_epipolar_lines,
    surely_on_epipolar_lines,
)
from app.vision.views.features import MIN_MATCHES, Matches, match_features, undistort_to_rays
from app.vision.views.relative_pose import (
    CENTRE_SPREAD,
    FOCAL_SPREAD,
    LENS_UNKNOWNS,
    MATCH_SD_PX_AT_12MP,
    MAX_MATCHES,
    RefinedViews,
    camera_with_lens,
    sampson_distance,
    undistort_by_lens,
)
from app.vision.views.stillness import poses_mismatch
from app.vision.views.table_plane import MAX_TILT_DEG, RigPose, find_table_plane, table_from_plane

TURN_SD_RAD = 3e-4  # prior, each axis: half a pixel of a phone's 2000 px focal length, as calibrations by hand reach
SHIFT_SD_SHARE = 0.003  # prior, of the baseline, each axis
# The same of known poses: ARKit and ARCore publish no figures; visual-inertial tracking is off by 1 to 3 % of the way
# and by 0.2 to 0.5 degrees between two photographs of a table.
POSES_TURN_SD_RAD = 6e-3
POSES_SHIFT_SD_SHARE = 0.02
# The same of an essential matrix, which tells a turn from a shift but badly.
OBJECT_TURN_SD_RAD = 3e-2
OBJECT_SHIFT_SD_SHARE = 0.1
# of the long side: what such poses put matches off their epipolar lines, three sd
ROUGH_GATE_SHARE = 0.025
ROUGH_DISTANCE_MM = 400.0  # of a table from a phone, where its true distance is not known yet

Source = Literal["rig", "poses", "object"]
PRIORS: Mapping[Source, tuple[float, float]] = {
    "rig": (TURN_SD_RAD, SHIFT_SD_SHARE),
    "poses": (POSES_TURN_SD_RAD, POSES_SHIFT_SD_SHARE),
    "object": (OBJECT_TURN_SD_RAD, OBJECT_SHIFT_SD_SHARE),
}
ROUGH_ROUNDS = (
    partial(near_epipolar_lines, limit_px_at_12mp=ROUGH_GATE_SHARE * LONG_SIDE_12MP),
    partial(near_epipolar_lines, limit_px_at_12mp=GATE_PX_AT_12MP),
    surely_on_epipolar_lines,
)
ROUNDS: Mapping[Source, tuple[Callable[[View, View, Matches], MaskArray], ...]] = {
    "rig": (surely_on_epipolar_lines,),
    "poses": ROUGH_ROUNDS,
    "object": ROUGH_ROUNDS,
}


def views_of_rig(
    pair: PhotoPair, rig: StereoRig, rng: np.random.Generator
) -> tuple[View, View] | Failure:
    """Left and right view over the table.

    Failures: camera_mismatch, same_photograph, table_not_found, poses_mismatch.
    """
    photos = pair.both
    if np.array_equal(photos[0].pixels_bgr, photos[1].pixels_bgr):
        return Failure(
            "same_photograph",
            "Both photographs are the same one.",
            "Send the photographs of both cameras of the rig.",
        )
    left_size, right_size = (
        (photo.pixels_bgr.shape[1], photo.pixels_bgr.shape[0]) for photo in photos
    )
    cameras = adapt_rig(rig, left_size, right_size)
    if isinstance(cameras, Failure):
        return cameras
    pose = RigPose(rig.right_from_left, np.array(rig.translation_mm))
    up = np.array(rig.up) if rig.up is not None else None
    if rig.source != "rig":
        adjusted = _adjusted_views(photos, cameras, pose, up, rig.source)
        if isinstance(adjusted, Failure):
            return adjusted
        cameras, pose = (
            (adjusted.first.camera, adjusted.second.camera),
            _relative_pose(adjusted.first, adjusted.second),
        )
    plane = find_table_plane((photos[0].pixels_bgr, photos[1].pixels_bgr), cameras, pose, rng, up)
    if isinstance(plane, Failure):
        return plane
    return _views_over(plane, photos, cameras, pose)


def _adjusted_views(
    photos: tuple[Photo, Photo],
    cameras: tuple[Camera, Camera],
    pose: RigPose,
    up: Float64Array | None,
    source: Source,
) -> RefinedViews | Failure:
    """A rough pose, and the lenses, adjusted to matches that are looked for over a table at a usual distance."""
    towards = np.array([0.0, 0.0, -1.0])
    normal = up if up is not None and up @ towards > np.cos(np.radians(MAX_TILT_DEG)) else towards
    table = np.append(normal, -normal[2] * ROUGH_DISTANCE_MM)
    first, second = _views_over(table, photos, cameras, pose)
    matches = match_features(first, second, ROUGH_GATE_SHARE)
    refined = refine_rig(first, second, matches, source)
    if refined.matches == 0:
        return poses_mismatch("hardly any point is found again where they put it.")
    return refined


def _views_over(
    plane: Float64Array, photos: tuple[Photo, Photo], cameras: tuple[Camera, Camera], pose: RigPose
) -> tuple[View, View]:
    rotation, translation_mm = table_from_plane(plane)
    left = View(photos[0], cameras[0], None, rotation, translation_mm, 0.0)
    return left, View(photos[1], cameras[1], None, *_second_pose(left, pose), 0.0)


def refine_rig(first: View, second: View, matches: Matches, source: Source = "rig") -> RefinedViews:
    """The second view adjusted to the matches near their epipolar lines, maximum a posteriori.

    What matches cannot tell, such as a turn that only shifts all disparities, stays as calibrated and remains a doubt.
    source: see StereoRig; of poses, each round keeps only the matches that the one before explains.
    """
    refined, spread = RefinedViews(first, second, np.zeros(3), 0), _prior_sd(source, first, second)
    change = np.zeros(len(spread))
    for is_near in ROUNDS[source]:
        near = is_near(refined.first, refined.second, matches)
        if np.count_nonzero(near) < MIN_MATCHES:  # so few may be near by chance
            near = np.zeros_like(near)
        refined, change = _fit_pose(first, second, matches, np.flatnonzero(near), spread, change)
    return refined


def _prior_sd(source: Source, first: View, second: View) -> Float64Array:
    """(6,) or (12,) sd of a turn, rad, and a shift, mm, of the second view; of poses also of both lenses.

    A calibrated rig has its lenses. A phone's lens moves between two photographs, to focus and against shake:
    logarithm of the focal length, then the principal point over it.
    """
    turn_rad, shift_share = PRIORS[source]
    pose = np.repeat(
        [
            turn_rad,
            shift_share * float(np.linalg.norm(_relative_pose(first, second).translation_mm)),
        ],
        3,
    )
    if source == "rig":
        return pose
    sides = [
        (FOCAL_SPREAD, *2 * (CENTRE_SPREAD * _long_side(view) / view.camera.fx,))
        for view in (first, second)
    ]
    return np.concatenate([pose, *sides])


def _long_side(view: View) -> int:
    return max(view.camera.width, view.camera.height)


def _fit_pose(
    first: View,
    second: View,
    matches: Matches,
    chosen: Int64Array,
    spread: Float64Array,
    start: Float64Array,
) -> tuple[RefinedViews, Float64Array]:
    """The second view, and perhaps both lenses, fitted to the chosen matches; and the change, in units of spread.

    spread: see _prior_sd. start: the change to begin with.
    """
    if len(chosen) > MAX_MATCHES:
        chosen = chosen[np.linspace(0, len(chosen) - 1, MAX_MATCHES).astype(np.int64)]
    first_px, second_px = matches.first_px[chosen], matches.second_px[chosen]
    rays, second_rays = undistort_to_rays(first, first_px), undistort_to_rays(second, second_px)
    calibrated = _relative_pose(first, second)
    match_sd = (
        MATCH_SD_PX_AT_12MP
        * max(first.camera.width, first.camera.height)
        / LONG_SIDE_12MP
        / first.camera.fx
    )

    def residual(change: Float64Array) -> Float64Array:
        values = change * spread
        moved, lenses = _changed(calibrated, values[:6]), _lenses(values)
        essential = cross_matrix(moved.translation_mm) @ moved.rotation
        ideal = [
            undistort_by_lens(each, lens)
            for each, lens in zip((rays, second_rays), lenses, strict=True)
        ]
        # In pixels of the lens tried: rays of a longer one lie closer, and it would fit better by that alone.
        focal = float(np.exp((lenses[0][0] + lenses[1][0]) / 2))
        return np.concatenate([change, sampson_distance(essential, *ideal) * focal / match_sd])

    change, normal = minimise(residual, start)
    axes = np.linalg.cholesky(np.linalg.inv(normal)).T

    def with_change(values: Float64Array) -> tuple[View, View]:
        moved, lenses = _changed(calibrated, values[:6] * spread[:6]), _lenses(values * spread)
        cameras = [
            camera_with_lens(view.camera, lens)
            for view, lens in zip((first, second), lenses, strict=True)
        ]
        return replace(first, camera=cameras[0]), replace(
            _placed(second, first, moved), camera=cameras[1]
        )

    doubts = tuple(with_change(change + axis) for axis in axes)
    return RefinedViews(*with_change(change), np.zeros(3), len(chosen), doubts), change


def _lenses(values: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(5,), (5,) how both lenses differ from their cameras, as relative_pose.py has them."""
    lenses = np.zeros((2, LENS_UNKNOWNS))
    if len(values) > 6:
        lenses[:, :3] = values[6:].reshape(2, 3)
    return lenses[0], lenses[1]


def _relative_pose(first: View, second: View) -> RigPose:
    rotation = second.rotation @ first.rotation.T
    return RigPose(rotation, second.translation_mm - rotation @ first.translation_mm)


def _changed(pose: RigPose, change: Float64Array) -> RigPose:
    """The pose turned by the vector change[:3], radians, and shifted by change[3:], mm."""
    turn = cv2.Rodrigues(change[:3])[0]
    return RigPose(turn @ pose.rotation, pose.translation_mm + change[3:])


def _second_pose(first: View, pose: RigPose) -> tuple[Float64Array, Float64Array]:
    return (
        pose.rotation @ first.rotation,
        pose.rotation @ first.translation_mm + pose.translation_mm,
    )


def _placed(second: View, first: View, pose: RigPose) -> View:
    rotation, translation_mm = _second_pose(first, pose)
    return replace(second, rotation=rotation, translation_mm=translation_mm)
