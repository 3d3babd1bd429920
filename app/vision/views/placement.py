"""The beginning of a run: its views over the table in mm, from the source that gives the scene its scale.

Photographs and options -> Placement. There are five sources, each with one function here: the marker, a calibrated rig,
the poses of a phone's tracking, the left photograph's depth map, and a known object. fallbacks.py chooses between them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.errors import Failure
from app.vision.board.camera import camera_from_exif, estimate_views
from app.vision.board.colour_correction import UNCORRECTED, measure_colour
from app.vision.board.marker import agree_on_corners, find_marker
from app.vision.board.round_object import MaybeCoin, find_round_objects
from app.vision.intrinsics import Camera, adapt_camera
from app.vision.known_object import KnownObject
from app.vision.known_poses import KnownPoses, rig_of_poses
from app.vision.marker_spec import MarkerSpec
from app.vision.model import (
    DepthMap,
    EstimateOptions,
    MarkerObservation,
    MaskArray,
    Photo,
    PhotoPair,
    View,
)
from app.vision.rig import StereoRig
from app.vision.views.depth_parallax import place_by_depth
from app.vision.views.features import match_features
from app.vision.views.focal_doubt import FLAG_SD, MOST_SD, FocalDoubt, doubt_focal, too_unsure
from app.vision.views.object_pair import ObjectRig, in_scale, rig_of_object
from app.vision.views.object_view import place_by_object
from app.vision.views.pose_doubt import volume_doubt
from app.vision.views.reconstruction import Reconstruction, plane_points
from app.vision.views.rectification import is_swapped
from app.vision.views.relative_pose import RefinedViews, refine_views
from app.vision.views.rig_pose import (
    POSES_SHIFT_SD_SHARE,
    POSES_TURN_SD_RAD,
    refine_rig,
    views_of_rig,
)
from app.vision.views.single_view import SingleView, place_alone, single_volume_sd
from app.vision.views.stillness import judge_heights, judge_matches, judge_missing, poses_mismatch
from app.vision.views.views_trace import Scale, ViewsTrace

SCALE_FLAGS: Mapping[Scale, tuple[str, ...]] = {
    "marker": (),
    "rig": ("scale_from_rig",),
    "poses": ("scale_from_poses",),
    "depth": ("scale_from_depth",),
    "object": ("scale_from_object",),
}
# Cosine of the optical axis and the table's normal, which looks up: within 30 degrees of straight down. Whoever takes
# one photograph so, and another in which neither the reference nor a match is found, takes that one from the side.
MOST_FROM_ABOVE = -0.87
# by which two views are near; those of ECUSTFD from above and from the side have fewer, 21 of 22
NEAR_MATCHES = 40
MAX_OFF_SD = 3.0  # of the table by poses from a marker's, in standard deviations of tracking


@dataclass(frozen=True, slots=True)
class Placement:
    """The views over the table and the source of their scale. focal: None where the focal length is known.

    side: beside a view from above, a photograph that shows the foods from the side and was not placed.
    """

    views: RefinedViews | SingleView
    scale: Scale
    focal: FocalDoubt | None = None
    side: Photo | None = None

    @property
    def marker(self) -> MarkerObservation | None:
        """The marker in the first view; None if the scale comes from elsewhere."""
        return self.views.first.marker


def doubt_volumes(
    placed: Placement, scene: Reconstruction, is_food: MaskArray
) -> tuple[float, tuple[str, ...]] | Failure:
    """Return the relative sd that poses, lenses and scale leave of the foods' volumes, and every item's flags.

    is_food: (H, W). Failure "focal_unknown".
    """
    views, flags = placed.views, SCALE_FLAGS[placed.scale]
    if placed.scale == "object" and views.first.camera.source == "board":
        flags = (*flags, "camera_unknown")  # which a board tells, and a coin does not
    if isinstance(views, SingleView):
        on_table = plane_points(scene.rectified)[is_food]
        middle_mm = np.nanmedian(on_table, axis=0)[:2].astype(np.float64)
        sd = single_volume_sd(views, middle_mm)
        is_unsure = sd > MOST_SD and placed.scale != "object"
        return too_unsure() if is_unsure else (sd, flags)
    doubt = volume_doubt(views, scene.points_table[is_food], placed.focal)
    if doubt.focal_sd > MOST_SD:
        return too_unsure()
    if doubt.focal_sd > FLAG_SD:
        flags = (*flags, "focal_unknown")
    return doubt.sd, flags


def views_by_marker(
    pair: PhotoPair,
    marker: MarkerSpec,
    options: EstimateOptions,
    trace: ViewsTrace,
    *,
    left_alone_after: Collection[str],
) -> Placement | Failure:
    """Poses by the marker, of two views refined by matches unless these show that something moved.

    A plain scene without matches leaves the poses as the marker alone shows them. left_alone_after: failures to find
    the marker in the right photograph after which the left one is placed alone (decision 0030).
    """
    with trace.stage("marker"):
        observations = _find_markers(pair, marker, left_alone_after, trace)
    if isinstance(observations, Failure):
        return observations
    left, right = observations
    with trace.stage("camera"):
        views = (
            place_alone(pair.left, left, options)
            if right is None
            else estimate_views(pair, (left, right), options)
        )
    if isinstance(views, Failure):
        return views
    if isinstance(views, SingleView):
        trace.keep_single(views)
        return Placement(views, "marker", side=_side_of(views, pair.right))
    first, second = _in_order(views, trace)
    with trace.stage("match"):
        matches = match_features(first, second)
        refined = refine_views(first, second, matches)
        is_good = trace.keep_matches(matches, refined)
        moved = judge_heights(refined, matches) if refined.matches else judge_missing(first, second)
        if moved is None:
            moved = judge_matches(matches, is_good, placed_by="marker")
        if moved is not None:
            return moved
        trace.focal = doubt_focal(refined.first, refined.second, camera_from_exif(pair.left))
    return Placement(refined, "marker", trace.focal)


def views_by_rig(
    pair: PhotoPair, rig: StereoRig, options: EstimateOptions, trace: ViewsTrace
) -> Placement | Failure:
    """The rig's views over the table that the scene shows, its relative pose adjusted by the matches.

    A plain scene without matches leaves the pose as calibrated. Colours stay, as nothing is known to be white, unless
    an attempt by the marker has measured them.
    """
    trace.colours = trace.colours or (UNCORRECTED, UNCORRECTED)
    with trace.stage("camera"):
        views = views_of_rig(pair, rig, np.random.default_rng(options.seed))
    if isinstance(views, Failure):
        return views
    first, second = _in_order(views, trace)
    with trace.stage("match"):
        matches = match_features(first, second)
        refined = refine_rig(first, second, matches, rig.source)
        is_good = trace.keep_matches(matches, refined)
        mismatch = judge_matches(matches, is_good, placed_by=rig.source)
        if mismatch is not None:
            return mismatch
    return Placement(refined, rig.source)


def views_by_poses(
    pair: PhotoPair, poses: KnownPoses, options: EstimateOptions, trace: ViewsTrace
) -> Placement | Failure:
    """By the rig that the pair's poses make. Failures also: focal_unknown (no intrinsics), camera_mismatch.

    If an attempt before saw the marker in the left photograph, the table by the poses has to be the marker's.
    """
    marker = trace.markers[0]
    if options.camera is None:
        return Failure(
            "focal_unknown",
            "Known poses need the camera's intrinsics, and neither the meal nor a calibration gives any.",
            "Send the camera's intrinsics with the poses; ARKit and ARCore tell them of each photograph.",
        )
    (left_h, left_w), (right_h, right_w) = (photo.pixels_bgr.shape[:2] for photo in pair.both)
    orientations = (pair.both[0].orientation, pair.both[1].orientation)
    rig = rig_of_poses(poses, options.camera, ((left_w, left_h), (right_w, right_h)), orientations)
    placed = rig if isinstance(rig, Failure) else views_by_rig(pair, rig, options, trace)
    if isinstance(placed, Failure) or marker is None or trace.views is None:
        return placed
    alone = place_alone(pair.left, marker, options)
    if isinstance(alone, Failure) or _share_table(trace.views[0], alone.first):
        return placed
    return poses_mismatch("the marker in the left photograph shows the table elsewhere.")


def _share_table(by_poses: View, by_marker: View) -> bool:
    """Return whether two placements of a photograph agree on the table, up to the doubt of poses."""
    cosine = float(by_poses.rotation[:, 2] @ by_marker.rotation[:, 2])
    log_ratio = float(np.log(by_poses.centre_mm[2] / by_marker.centre_mm[2]))
    is_level = np.arccos(np.clip(cosine, -1.0, 1.0)) < MAX_OFF_SD * POSES_TURN_SD_RAD
    return bool(is_level and abs(log_ratio) < MAX_OFF_SD * POSES_SHIFT_SD_SHARE)


def views_by_depth(
    photo: Photo, depth: DepthMap, options: EstimateOptions, trace: ViewsTrace
) -> Placement | Failure:
    """The left photograph's view over the table that its depth map shows; colours stay as with a rig."""
    trace.colours = UNCORRECTED, UNCORRECTED
    with trace.stage("camera"):
        camera = _camera_of(photo, options)
        if isinstance(camera, Failure):
            return camera
        view = place_by_depth(photo, camera, depth, np.random.default_rng(options.seed))
    if isinstance(view, Failure):
        return view
    trace.keep_single(view)
    return Placement(view, "depth")


def views_by_object(
    pair: PhotoPair, known: KnownObject, options: EstimateOptions, trace: ViewsTrace
) -> Placement | Failure:
    """Both views by the coin in them and by matches; where these do not allow it, the left one alone by its coin.

    Colours stay as with a rig. Failures: marker_not_found, camera_mismatch.
    """
    trace.colours = UNCORRECTED, UNCORRECTED
    with trace.stage("marker"):
        left = _find_objects(pair.left, known, options, "left")
        if isinstance(left, Failure):
            return left
        right = None if pair.right is None else _find_objects(pair.right, known, options, "right")
    camera, coins = left
    alone = place_by_object(pair.left, camera, coins[0].ellipse, known)
    side = _side_of(alone, pair.right)
    if right is not None and not isinstance(right, Failure):
        with trace.stage("camera"):
            made = rig_of_object(pair, (camera, right[0]), (coins, right[1]), known)
        if made is not None:
            placed = _pair_by_object(pair, known, made, options, trace)
            if placed is not None:
                return placed
            trace.forget_pair()
        there = place_by_object(pair.both[1], right[0], right[1][0].ellipse, known)
        # On the table it is seen at a slant or nearly as from the left; what stands there looks round.
        is_near = made is not None and made.matches >= NEAR_MATCHES
        if is_near or there.first.rotation[2, 2] > MOST_FROM_ABOVE:
            side = None
    trace.keep_single(alone)
    return Placement(alone, "object", side=side)


def _side_of(alone: SingleView, right: Photo | None) -> Photo | None:
    """Return the right photograph if it shows from the side what the left one shows from above."""
    return right if alone.first.rotation[2, 2] < MOST_FROM_ABOVE else None


def _pair_by_object(
    pair: PhotoPair,
    known: KnownObject,
    made: ObjectRig,
    options: EstimateOptions,
    trace: ViewsTrace,
) -> Placement | None:
    """Return both views by the rig of their matches, in the coin's scale."""
    for rig in (made.rig, replace(made.rig, up=None)):  # a small coin tells the tilt badly
        placed = views_by_rig(pair, rig, options, trace)
        if isinstance(placed, Failure) or trace.refined is None:
            continue
        refined = in_scale(trace.refined, made.coins, known, is_swapped=trace.is_swapped)
        if refined is not None:
            trace.keep_views(refined)
            return Placement(refined, "object")
    return None


def _find_objects(
    photo: Photo, known: KnownObject, options: EstimateOptions, side: str
) -> tuple[Camera, Sequence[MaybeCoin]] | Failure:
    """Return a photograph's camera and what may be the coin in it, the likeliest first."""
    camera = _camera_of(photo, options)
    if isinstance(camera, Failure):
        return camera
    coins = find_round_objects(photo, camera, known, side)
    return coins if isinstance(coins, Failure) else (camera, coins)


def _camera_of(photo: Photo, options: EstimateOptions) -> Camera | Failure:
    """Return the camera that is given, at the photograph's size, or that of its EXIF."""
    if options.camera is None:
        return camera_from_exif(photo)
    return adapt_camera(options.camera, photo.pixels_bgr.shape[1], photo.pixels_bgr.shape[0])


def _find_markers(
    pair: PhotoPair, marker: MarkerSpec, left_alone_after: Collection[str], trace: ViewsTrace
) -> tuple[MarkerObservation, MarkerObservation | None] | Failure:
    """The marker in both photographs, or in the left one alone, see views_by_marker."""
    left = find_marker(pair.left, marker, "left")
    if isinstance(left, Failure):
        return left
    right = find_marker(pair.right, marker, "right") if pair.right is not None else None
    if pair.right is None or right is None or isinstance(right, Failure):
        trace.markers = (left, None)
        trace.colours = measure_colour(pair.left, left), UNCORRECTED
        if isinstance(right, Failure) and right.code not in left_alone_after:
            return right
        return left, None
    trace.markers = observations = agree_on_corners(pair, left, right)
    trace.colours = measure_colour(pair.left, left), measure_colour(pair.right, right)
    return observations


def _in_order(views: tuple[View, View], trace: ViewsTrace) -> tuple[View, View]:
    """The left and the right view, (first, second) by where they stand."""
    trace.views, trace.is_swapped = views, is_swapped(*views)
    return (views[1], views[0]) if trace.is_swapped else views
