"""The founding paper's flow chart (Figure 3): photographs in, the volume of each food out, step after step.

Photographs arrive decoded (photo.py); densities and nutrients are for others.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace

import numpy as np

from app.core.errors import Failure
from app.vision.added_depth import add_depths, parallax_alone
from app.vision.board.camera import camera_from_exif, estimate_views
from app.vision.board.colour_correction import UNCORRECTED, measure_colour
from app.vision.board.marker import agree_on_corners, find_marker
from app.vision.figures import draw_artefacts
from app.vision.intrinsics import Camera, adapt_camera
from app.vision.known_poses import KnownPoses, rig_of_poses
from app.vision.looks.vcm import describe_rings
from app.vision.model import (
    DepthMap,
    EstimateOptions,
    Hint,
    ItemEstimate,
    MarkerObservation,
    MealEstimate,
    Photo,
    PhotoPair,
    View,
)
from app.vision.rig import StereoRig
from app.vision.scene.liquids import segment_meal
from app.vision.scene.segmentation import Foods
from app.vision.shape.depth_slices import measure_as_printed
from app.vision.shape.measure import MeasuredItem, measure_items, of_single_view
from app.vision.shape.outlines import draw_hints, photograph_px, rings_of
from app.vision.shape.shape import measure_shapes
from app.vision.shape.tuning import TUNING
from app.vision.stereo.depth_parallax import place_by_depth
from app.vision.stereo.disparity import match_dense
from app.vision.stereo.epipolar import compare_fundamentals
from app.vision.stereo.features import NO_MATCHES, match_features, shows_sheet
from app.vision.stereo.focal_doubt import FLAG_SD, MOST_SD, doubt_focal, too_unsure
from app.vision.stereo.marker_thickness import find_thickness, on_plaque
from app.vision.stereo.other_views import choose_partner, place_other_views
from app.vision.stereo.pinhole_view import undistorted_view
from app.vision.stereo.pose_doubt import volume_doubt
from app.vision.stereo.printed_stereo import reconstruct_as_printed
from app.vision.stereo.reconstruction import back_project, fit_to_marker, ideal_depth, plane_points
from app.vision.stereo.rectification import is_swapped, rectify_alone, rectify_by_poses
from app.vision.stereo.relative_pose import RefinedViews, refine_views
from app.vision.stereo.rig_pose import refine_rig, views_of_rig
from app.vision.stereo.single_view import SingleView, place_alone, single_volume_sd
from app.vision.stereo.stillness import judge_heights, judge_matches, judge_table
from app.vision.trace import Reconstruction, Trace
from app.vision.traits import traits_of
from app.vision.version import PIPELINE_VERSION

# Why the right photograph may be left out: the marker is not seen in it. Another board is seen, or the whole
# photograph is poor, and who photographs should hear of it.
MARKER_UNSEEN = frozenset({"marker_not_found", "marker_covered"})
# Why a pair fails of which the left photograph alone may be measured, if it has a depth map.
PAIR_UNUSABLE = frozenset(
    {"baseline_too_small", "baseline_too_large", "too_few_matches", "scene_moved", "food_not_measured"}
)


def estimate_meal(
    pair: PhotoPair,
    options: EstimateOptions,
    *,
    on_stage: Callable[[str], None] = lambda _: None,
    want_artefacts: bool = False,
) -> MealEstimate:
    """Volumes of the foods in a stereo pair, or in one photograph. on_stage hears each stage's name as it begins.

    What the photographs do not allow is told in MealEstimate.failure; views and artefacts show how far the run came.
    """
    stages: dict[str, float] = {}
    chosen, trace, outcome = _run_with_partner(pair, options, _Stages(stages, on_stage))
    items = () if isinstance(outcome, Failure) else outcome
    return MealEstimate(
        method=options.method,
        pipeline_version=PIPELINE_VERSION,
        stages=stages,
        items=items,
        failure=outcome if isinstance(outcome, Failure) else None,
        views=trace.views,
        parameters={"seed": options.seed, **trace.parameters(), "tuning": asdict(TUNING)},
        artefacts=draw_artefacts(trace, chosen, items) if want_artefacts else (),
        colours=trace.colours,
        second_place=trace.second_place,
    )


def _run_with_partner(
    pair: PhotoPair, options: EstimateOptions, stage: "_Stages"
) -> tuple[PhotoPair, Trace, tuple[ItemEstimate, ...] | Failure]:
    """Run with the best partner of the left photograph; if that fails, with the right one, as the phone paired them.

    If that fails as well, a depth map may measure the left one alone.
    """
    chosen = pair
    if pair.others and options.marker is not None:
        with stage("marker"):
            chosen = choose_partner(pair, options.marker)
    places = [place for place, photo in enumerate((pair.right, *pair.others), start=1) if photo is chosen.right]
    trace = Trace(second_place=places[0])
    outcome = _run(chosen, options, stage, trace)
    if isinstance(outcome, Failure) and chosen.right is not pair.right:
        chosen, trace = pair, Trace()
        outcome = _run(chosen, options, stage, trace)
    if isinstance(outcome, Failure) and outcome.code in PAIR_UNUSABLE and _is_measurable_alone(pair, options):
        alone, trace_alone = PhotoPair(pair.left), Trace()
        measured = _run(alone, options, stage, trace_alone)
        if not isinstance(measured, Failure):
            return alone, trace_alone, measured
    if isinstance(outcome, Failure) and outcome.code in MARKER_UNSEEN and options.poses and pair.right is not None:
        by_poses = Trace()
        measured = _run(pair, replace(options, marker=None), stage, by_poses)
        if not isinstance(measured, Failure):
            return pair, by_poses, measured
    return chosen, trace, outcome


def _is_measurable_alone(pair: PhotoPair, options: EstimateOptions) -> bool:
    return pair.left.depth is not None and options.marker is not None and options.method == "shape"


def _run(
    pair: PhotoPair, options: EstimateOptions, stage: "_Stages", trace: Trace
) -> tuple[ItemEstimate, ...] | Failure:
    """Run by the marker, by the rig, or without either by the rig of the known poses."""
    if options.rig is None and options.marker is None and options.poses is not None and pair.right is not None:
        rig = _rig_of_poses(pair, options.poses, options.camera)
        if isinstance(rig, Failure):
            return rig
        options = replace(options, rig=rig)
    return _run_steps(pair, options, stage, trace)


def _run_steps(
    pair: PhotoPair, options: EstimateOptions, stage: "_Stages", trace: Trace
) -> tuple[ItemEstimate, ...] | Failure:
    refined = _find_views(pair, options, stage, trace)
    if isinstance(refined, Failure):
        return refined
    scene = _reconstruct(refined, stage)
    marker = refined.first.marker
    if isinstance(refined, RefinedViews) and marker is not None and marker.spec.thick_mm == 0:
        with stage("depth"):
            thick_mm = find_thickness(marker.spec, scene.table_points())
        if thick_mm > 0:  # a plaque carries the print: its table frame lies deeper
            refined = on_plaque(refined, thick_mm)
            trace.keep_views(refined)
            scene = _reconstruct(refined, stage)
    trace.scene = scene
    if pair.others and isinstance(refined, RefinedViews) and marker is not None:
        with stage("match"):
            trace.others = place_other_views(pair.others, refined, options)
    moved = judge_table(marker.spec, scene.plane_mm, scene.points_table) if marker is not None else None
    if moved is not None:
        return moved
    if options.method == "shape":
        with stage("depth"):
            trace.scene = scene = add_depths(scene, refined, trace.others)
    with stage("segment"):
        left = refined.second if trace.is_swapped and isinstance(refined, RefinedViews) else refined.first
        places = photograph_px(scene.rectified, scene.points_table, left, is_swapped=trace.is_swapped)
        size = (pair.left.pixels_bgr.shape[1], pair.left.pixels_bgr.shape[0])
        hints = draw_hints(options.hints, places, size)
        foods = segment_meal(scene.rectified, scene.disparity, scene.points_table, scene.is_ignored, hints, options)
        if isinstance(foods, Failure):
            return foods
    with stage("volume"):
        measured = _measure(foods, refined, scene, options, trace)
        if isinstance(measured, Failure):
            return measured
        trace.items = measured = [replace(item, flags=(*item.flags, *scene.flags)) for item in measured]
    with stage("describe"):
        colour, left_colour = trace.colour_of(0), trace.colour_of(1 if trace.is_swapped else 0)
        outlines = [rings_of(item.region.mask, places, is_swapped=trace.is_swapped) for item in measured]
        items = tuple(
            ItemEstimate(
                rings=rings,
                volume_ml=item.volume.volume_ml if item.volume is not None else None,
                volume_interval_ml=item.volume.interval_ml if item.volume is not None else None,
                relative_sd=item.volume.relative_sd if item.volume is not None else {},
                hint=item.region.hint,
                flags=item.flags,
                traits=traits_of(item.region.mask, scene.points_table, scene.rectified.first_bgr, colour),
                vcm=describe_rings(pair.left.pixels_bgr, rings, left_colour),
            )
            for item, rings in zip(measured, outlines, strict=True)
        )
        return items + _missed(options.hints, items)


def _find_views(
    pair: PhotoPair, options: EstimateOptions, stage: "_Stages", trace: Trace
) -> RefinedViews | SingleView | Failure:
    """Cameras and poses by the rig or the marker, of two views refined by matches of the whole scene."""
    rig = options.rig
    if rig:
        views: tuple[View, View] | SingleView | Failure = _views_of_rig(pair, rig, options, stage, trace)
    elif options.marker is None and pair.left.depth is not None:
        views = _view_by_depth(pair.left, pair.left.depth, options, stage, trace)
    else:
        views = _views_by_marker(pair, options, stage, trace)
        depth = pair.left.depth if options.method == "shape" else None
        if isinstance(views, Failure) and views.code in MARKER_UNSEEN and depth is not None:
            views = _view_by_depth(pair.left, depth, options, stage, trace)
    if isinstance(views, Failure):
        return views
    if isinstance(views, SingleView):
        trace.keep_single(views)
        return views
    trace.views, trace.is_swapped = views, is_swapped(*views)
    first, second = views[::-1] if trace.is_swapped else views
    with stage("match"):
        if rig:
            return _refine_rig(first, second, rig, options, trace)
        return _refine_poses(first, second, camera_from_exif(pair.left), options, trace)


def _refine_poses(
    first: View, second: View, guess: Camera, options: EstimateOptions, trace: Trace
) -> RefinedViews | Failure:
    """Poses by the marker refined by the matches, unless these show that something moved. guess: by EXIF."""
    matches = match_features(first, second)
    if isinstance(matches, Failure):
        return matches
    refined = refine_views(first, second, matches)
    trace.matches = matches
    trace.keep_views(refined)
    moved = judge_heights(refined, matches)
    if moved is not None:
        return moved
    trace.focal = doubt_focal(refined.first, refined.second, guess)
    epipolar = compare_fundamentals(refined.first, refined.second, matches, np.random.default_rng(options.seed))
    if isinstance(epipolar, Failure):
        return epipolar
    moved = judge_matches(matches, epipolar.is_good, placed_by="marker")
    if moved is not None:
        return moved
    trace.epipolar = epipolar
    return refined


def _refine_rig(
    first: View, second: View, rig: StereoRig, options: EstimateOptions, trace: Trace
) -> RefinedViews | Failure:
    """The rig's relative pose adjusted by the matches; a plain scene without any leaves it as calibrated."""
    matches = match_features(first, second)
    if isinstance(matches, Failure):
        matches = NO_MATCHES
    refined = refine_rig(first, second, matches, rig.source)
    trace.matches = matches
    trace.keep_views(refined)
    epipolar = compare_fundamentals(refined.first, refined.second, matches, np.random.default_rng(options.seed))
    if isinstance(epipolar, Failure):
        return refined
    trace.epipolar = epipolar
    mismatch = judge_matches(matches, epipolar.is_good, placed_by=rig.source)
    return refined if mismatch is None else mismatch


def _views_by_marker(
    pair: PhotoPair, options: EstimateOptions, stage: "_Stages", trace: Trace
) -> tuple[View, View] | SingleView | Failure:
    with stage("marker"):
        observations = _find_markers(pair, options, trace)
    if isinstance(observations, Failure):
        return observations
    with stage("camera"):
        left, right = observations
        if right is None:
            return place_alone(pair.left, left, options)
        return estimate_views(pair, (left, right), options)


def _view_by_depth(
    photo: Photo, depth: DepthMap, options: EstimateOptions, stage: "_Stages", trace: Trace
) -> SingleView | Failure:
    """The left photograph's view over the table that its depth map shows; the map gives the scale."""
    trace.colours = UNCORRECTED, UNCORRECTED
    with stage("camera"):
        camera = camera_from_exif(photo)
        if options.camera is not None:
            adapted = adapt_camera(options.camera, photo.pixels_bgr.shape[1], photo.pixels_bgr.shape[0])
            if isinstance(adapted, Failure):
                return adapted
            camera = adapted
        return place_by_depth(photo, camera, depth, np.random.default_rng(options.seed))


def _views_of_rig(
    pair: PhotoPair, rig: StereoRig, options: EstimateOptions, stage: "_Stages", trace: Trace
) -> tuple[View, View] | Failure:
    """The rig's views over the table that the scene shows. Nothing in it tells what white is: colours stay."""
    trace.colours = UNCORRECTED, UNCORRECTED
    with stage("camera"):
        return views_of_rig(pair, rig, np.random.default_rng(options.seed))


def _rig_of_poses(pair: PhotoPair, poses: KnownPoses, camera: Camera | None) -> StereoRig | Failure:
    """The rig of the pair's poses. Failures: focal_unknown (without intrinsics), camera_mismatch."""
    if camera is None:
        return Failure(
            "focal_unknown",
            "Known poses need the camera's intrinsics, and neither the meal nor a calibration gives any.",
            "Send the camera's intrinsics with the poses; ARKit and ARCore tell them of each photograph.",
        )
    (left_h, left_w), (right_h, right_w) = (photo.pixels_bgr.shape[:2] for photo in pair.both)
    orientations = (pair.both[0].orientation, pair.both[1].orientation)
    return rig_of_poses(poses, camera, ((left_w, left_h), (right_w, right_h)), orientations)


def _missed(hints: Sequence[Hint], items: Sequence[ItemEstimate]) -> tuple[ItemEstimate, ...]:
    """An item without outline and volume for each hint at whose place nothing could be measured."""
    answered = {item.hint for item in items}
    flags = ("not_measurable", "hint_missed")
    return tuple(
        ItemEstimate(rings=(), volume_ml=None, volume_interval_ml=None, relative_sd={}, hint=index, flags=flags)
        for index, hint in enumerate(hints)
        if hint.has_place and index not in answered
    )


def _measure(
    foods: Foods,
    refined: RefinedViews | SingleView,
    scene: Reconstruction,
    options: EstimateOptions,
    trace: Trace,
) -> list[MeasuredItem] | Failure:
    """Volumes by the method asked for, each with the doubt that poses and lenses leave."""
    pair, disparity, points = scene.rectified, scene.disparity, scene.points_table
    if isinstance(refined, SingleView):
        trace.table = foods.table
        pose_sd = single_volume_sd(refined, np.nanmedian(scene.plane_mm[foods.mask], axis=0)[:2].astype(np.float64))
        if pose_sd > MOST_SD:
            return too_unsure()
        measured = measure_shapes(foods, pair, disparity, points, pose_sd=pose_sd, hints=options.hints)
        if isinstance(measured, Failure):
            return measured
        hints = [None if item.region.hint is None else options.hints[item.region.hint] for item in measured]
        measured = [of_single_view(item, hint) for item, hint in zip(measured, hints, strict=True)]
        if refined.first.marker is not None:
            return measured
        return [replace(item, flags=(*item.flags, "scale_from_depth")) for item in measured]
    doubt = volume_doubt(refined, points[foods.mask], trace.focal)
    if doubt.focal_sd > MOST_SD:
        return too_unsure()
    if options.method == "paper":
        measured = measure_items(
            foods.regions, pair, disparity, points, scene.is_ignored, options.hints, pose_sd=doubt.sd
        )
    elif options.method == "paper-strict":
        measured = _measure_as_printed(foods, refined, scene, options, trace)
    else:
        trace.table = foods.table
        others = [undistorted_view(view, pair.focal_px) for view in trace.others]
        measured = measure_shapes(
            foods,
            pair,
            disparity,
            points,
            pose_sd=doubt.sd,
            hints=options.hints,
            others=others,
            depths=scene.depths,
        )
    if isinstance(measured, Failure) or (options.rig is None and doubt.focal_sd <= FLAG_SD):
        return measured
    if options.rig is None:
        return [replace(item, flags=(*item.flags, "focal_unknown")) for item in measured]
    is_by_poses = options.rig.source == "poses"
    return [
        replace(item, flags=(*item.flags, "scale_from_poses" if is_by_poses else "scale_from_rig")) for item in measured
    ]


def _measure_as_printed(
    foods: Foods, refined: RefinedViews, scene: Reconstruction, options: EstimateOptions, trace: Trace
) -> list[MeasuredItem] | Failure:
    """Volumes by the founding paper to the letter; of what stands above, the foods' masks alone take part."""
    if trace.matches is None or refined.first.marker is None:
        raise ValueError("The method paper-strict takes its tie points from a marker, not from a rig.")
    masks, rng = [region.mask for region in foods.regions], np.random.default_rng(options.seed)
    stereo = reconstruct_as_printed(refined, trace.matches, scene.rectified, masks, rng)
    if isinstance(stereo, Failure):
        return stereo
    trace.printed = stereo
    return measure_as_printed(foods.regions, stereo, options.hints)


def _reconstruct(refined: RefinedViews | SingleView, stage: "_Stages") -> Reconstruction:
    """Points in the views' table frame; none of a single view."""
    marker = refined.first.marker
    with stage("rectify"):
        if isinstance(refined, RefinedViews):
            rectified = rectify_by_poses(refined.first, refined.second)
        else:
            rectified = rectify_alone(refined.first)
    with stage("disparity"):
        plane = plane_points(rectified)
        sheet = np.zeros(rectified.shape, np.bool_)
        if marker is not None:
            sheet = shows_sheet(marker, plane, rectified.first_centre_mm)
        flags: tuple[str, ...] = ()
        if rectified.second_bgr is None:
            disparity, flags = parallax_alone(rectified, refined.first, sheet)
        else:
            disparity = match_dense(*rectified.both_bgr, rectified.parallax_range_px, rectified.is_seen)
    with stage("depth"):
        if isinstance(refined, RefinedViews) and marker is not None:
            depth = fit_to_marker(rectified, refined)
        else:
            depth = ideal_depth(rectified)
        depth_mm = depth.depth_mm(rectified.disparity_from_parallax(disparity.parallax_px))
        points = back_project(rectified, depth_mm)
    return Reconstruction(rectified, disparity, depth, points, plane, sheet | ~rectified.is_seen, flags=flags)


def _find_markers(
    pair: PhotoPair, options: EstimateOptions, trace: Trace
) -> tuple[MarkerObservation, MarkerObservation | None] | Failure:
    """The marker in both photographs, or in the left one alone, which is then measured alone (decision 0030)."""
    if options.marker is None:
        raise ValueError("Options need a marker or a rig: one of them gives the scale.")
    left = find_marker(pair.left, options.marker, "left")
    right = find_marker(pair.right, options.marker, "right") if pair.right is not None else None
    if isinstance(left, Failure):
        trace.markers = (None, None if isinstance(right, Failure) else right)
        return left
    if pair.right is None or right is None or isinstance(right, Failure):
        if isinstance(right, Failure) and (right.code not in MARKER_UNSEEN or options.method != "shape"):
            trace.markers = (left, None)
            return right
        trace.markers = (left, None)
        trace.colours = measure_colour(pair.left, left), UNCORRECTED
        return left, None
    trace.markers = observations = agree_on_corners(pair, left, right)
    trace.colours = measure_colour(pair.left, left), measure_colour(pair.right, right)
    return observations


class _Stages:
    """Tells when a stage begins for the first time and keeps how long it took in all, seconds."""

    def __init__(self, seconds: dict[str, float], on_stage: Callable[[str], None]) -> None:
        self._seconds = seconds
        self._on_stage = on_stage

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        if name not in self._seconds:  # a plaque's scene is reconstructed again
            self._on_stage(name)
        started = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[name] = self._seconds.get(name, 0.0) + time.perf_counter() - started
