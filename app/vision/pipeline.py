"""The founding paper's flow chart (Figure 3): two photographs in, the volume of each food out, step after step.

Photographs arrive decoded (photo.py); densities and nutrients are for others.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from app.errors import Failure
from app.vision.camera import estimate_views
from app.vision.color import measure_colour
from app.vision.disparity import match_dense
from app.vision.epipolar import Epipolar, compare_fundamentals
from app.vision.features import Matches, is_on_sheet, match_features
from app.vision.figures import draw_artefacts
from app.vision.liquids import segment_meal
from app.vision.marker import agree_on_corners, find_marker
from app.vision.measure import measure_items
from app.vision.model import EstimateOptions, ItemEstimate, MarkerObservation, MealEstimate, PhotoPair, View
from app.vision.outlines import draw_hints, photograph_px, rings_of
from app.vision.pose_doubt import volume_sd
from app.vision.reconstruction import back_project, fit_to_marker, plane_points
from app.vision.rectification import is_swapped, rectify_by_poses
from app.vision.relative_pose import refine_views
from app.vision.shape import measure_shapes
from app.vision.stillness import judge_matches, judge_table
from app.vision.trace import Trace
from app.vision.traits import traits_of
from app.vision.vcm import describe_rings

PIPELINE_VERSION = "5"  # changes whenever the same photographs may give another answer


def estimate_meal(
    pair: PhotoPair,
    options: EstimateOptions,
    *,
    on_stage: Callable[[str], None] = lambda _: None,
    want_artefacts: bool = False,
) -> MealEstimate:
    """Volumes of the foods in a stereo pair. on_stage hears each stage's name as it begins.

    What the photographs do not allow is told in MealEstimate.failure; views and artefacts show how far the run came.
    """
    stages: dict[str, float] = {}
    trace = Trace()
    found = _run(pair, options, _Stages(stages, on_stage), trace)
    items = () if isinstance(found, Failure) else found
    return MealEstimate(
        method=options.method,
        pipeline_version=PIPELINE_VERSION,
        stages=stages,
        items=items,
        failure=found if isinstance(found, Failure) else None,
        views=trace.views,
        parameters={"seed": options.seed, **trace.parameters()},
        artefacts=draw_artefacts(trace, pair, items) if want_artefacts else (),
        colours=trace.colours,
    )


def _run(
    pair: PhotoPair, options: EstimateOptions, stage: "_Stages", trace: Trace
) -> tuple[ItemEstimate, ...] | Failure:
    with stage("marker"):
        observations = _find_markers(pair, options, trace)
        if isinstance(observations, Failure):
            return observations
    with stage("camera"):
        views = estimate_views(pair, observations, options)
        if isinstance(views, Failure):
            return views
        trace.views, trace.is_swapped = views, is_swapped(*views)
        first, second = views[::-1] if trace.is_swapped else views
    with stage("match"):
        matches = match_features(first, second)
        if isinstance(matches, Failure):
            return matches
        trace.matches, trace.refined = matches, refine_views(first, second, matches)
        first, second = trace.refined.first, trace.refined.second
        trace.views = (second, first) if trace.is_swapped else (first, second)
        epipolar = _compare(first, second, matches, np.random.default_rng(options.seed))
        if isinstance(epipolar, Failure):
            return epipolar
        trace.epipolar = epipolar
    with stage("rectify"):
        trace.rectified = rectified = rectify_by_poses(first, second)
    with stage("disparity"):
        trace.disparity = match_dense(
            rectified.first_bgr, rectified.second_bgr, rectified.parallax_range_px, rectified.is_seen
        )
    with stage("depth"):
        trace.depth = fit_to_marker(rectified, trace.refined)
        disparity = rectified.disparity_from_parallax(trace.disparity.parallax_px)
        trace.points_table = points = back_project(rectified, trace.depth.depth_mm(disparity))
        plane = plane_points(rectified)
        moved = judge_table(options.marker, plane, points)
        if moved is not None:
            return moved
    with stage("segment"):
        ignored = is_on_sheet(options.marker, plane) | ~rectified.is_seen
        places = photograph_px(rectified, points, trace.views[0], is_swapped=trace.is_swapped)
        size = (pair.left.pixels_bgr.shape[1], pair.left.pixels_bgr.shape[0])
        hints = draw_hints(options.hints, places, size)
        foods = segment_meal(rectified, trace.disparity, points, ignored, hints, options)
        if isinstance(foods, Failure):
            return foods
    with stage("volume"):
        pose_sd = volume_sd(trace.refined, points[foods.mask])
        if options.method == "paper":
            measured = measure_items(
                foods.regions, rectified, trace.disparity, points, ignored, options.hints, pose_sd=pose_sd
            )
        else:
            trace.table = foods.table
            measured = measure_shapes(foods, rectified, trace.disparity, points, pose_sd=pose_sd)
        if isinstance(measured, Failure):
            return measured
        trace.items = measured
    with stage("describe"):
        colour, left_colour = trace.colour_of(0), trace.colour_of(1 if trace.is_swapped else 0)
        outlines = [rings_of(item.region.mask, places, is_swapped=trace.is_swapped) for item in measured]
        return tuple(
            ItemEstimate(
                rings=rings,
                volume_ml=item.volume.volume_ml if item.volume is not None else None,
                volume_interval_ml=item.volume.interval_ml if item.volume is not None else None,
                relative_sd=item.volume.relative_sd if item.volume is not None else {},
                hint=item.region.hint,
                flags=item.flags,
                traits=traits_of(item.region.mask, points, rectified.first_bgr, colour),
                vcm=describe_rings(pair.left.pixels_bgr, rings, left_colour),
            )
            for item, rings in zip(measured, outlines, strict=True)
        )


def _find_markers(
    pair: PhotoPair, options: EstimateOptions, trace: Trace
) -> tuple[MarkerObservation, MarkerObservation] | Failure:
    """The marker in both photographs; in one only, the trace keeps that one."""
    left = find_marker(pair.left, options.marker, "left")
    right = find_marker(pair.right, options.marker, "right")
    trace.markers = _if_found(left), _if_found(right)
    if isinstance(left, Failure):
        return left
    if isinstance(right, Failure):
        return right
    trace.markers = observations = agree_on_corners(pair, left, right)
    trace.colours = measure_colour(pair.left, left), measure_colour(pair.right, right)
    return observations


def _if_found(marker: MarkerObservation | Failure) -> MarkerObservation | None:
    return None if isinstance(marker, Failure) else marker


def _compare(first: View, second: View, matches: Matches, rng: np.random.Generator) -> Epipolar | Failure:
    epipolar = compare_fundamentals(first, second, matches, rng)
    if isinstance(epipolar, Failure):
        return epipolar
    moved = judge_matches(matches, epipolar.is_good)
    return epipolar if moved is None else moved


class _Stages:
    """Tells when a stage begins and keeps how long it took, seconds."""

    def __init__(self, seconds: dict[str, float], on_stage: Callable[[str], None]) -> None:
        self._seconds = seconds
        self._on_stage = on_stage

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        self._on_stage(name)
        started = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[name] = time.perf_counter() - started
