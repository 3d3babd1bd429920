"""The founding paper's flow chart (Figure 3): photographs in, the volume of each food out, step after step.

Photographs arrive decoded (photo.py); densities and nutrients are for others.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from app.core.errors import Failure
from app.vision.figures import draw_artefacts
from app.vision.looks.traits import traits_of
from app.vision.looks.vcm import describe_rings
from app.vision.model import (
    EstimateOptions,
    Float32Array,
    Float64Array,
    Hint,
    ItemEstimate,
    MealEstimate,
    PhotoPair,
)
from app.vision.paper.depth_slices import measure_as_printed
from app.vision.paper.measure_items import measure_items
from app.vision.paper.printed_stereo import reconstruct_as_printed
from app.vision.placement import MARKER_UNSEEN, Placement, doubt_volumes, place_views
from app.vision.reconstruct import add_depths, reconstruct_over_table
from app.vision.scene.liquids import segment_meal
from app.vision.scene.segmentation import Foods
from app.vision.solids.form_prior import LikelyForms, form_prior
from app.vision.solids.measured_item import MeasuredItem, of_single_view
from app.vision.solids.outlines import draw_hints, photograph_px, rings_of
from app.vision.solids.shape import measure_shapes
from app.vision.trace import Reconstruction, Stages, Trace
from app.vision.tuning import TUNING
from app.vision.version import PIPELINE_VERSION
from app.vision.views.features import too_few_matches
from app.vision.views.other_views import place_other_views, stereo_partners
from app.vision.views.pinhole_view import undistorted_view
from app.vision.views.reconstruction import plane_points
from app.vision.views.relative_pose import RefinedViews
from app.vision.views.single_view import SingleView
from app.vision.views.stillness import judge_table

UNMEASURED = frozenset({"no_food_found", "food_not_measured"})
# Failures of a pair after which its left photograph alone may be measured, if it has a depth map.
PAIR_UNUSABLE = frozenset(
    {
        "baseline_too_small",
        "baseline_too_large",
        "too_few_matches",
        "scene_moved",
        "food_not_measured",
    }
)


def estimate_meal(
    pair: PhotoPair,
    options: EstimateOptions,
    *,
    on_stage: Callable[[str], None] = lambda _: None,
    want_artefacts: bool = False,
) -> MealEstimate:
    """Volumes of the foods in a stereo pair, or in one photograph. on_stage hears each stage's name as it begins.

    MealEstimate.failure says what the photographs do not allow; views and artefacts show how far the run came.
    """
    stage = Stages(on_stage)
    run = _run_with_fallbacks(pair, options, stage)
    items = () if isinstance(run.outcome, Failure) else run.outcome
    return MealEstimate(
        method=options.method,
        pipeline_version=PIPELINE_VERSION,
        stages=stage.seconds,
        items=items,
        failure=run.outcome if isinstance(run.outcome, Failure) else None,
        views=run.trace.views,
        parameters={"seed": options.seed, **run.trace.parameters(), "tuning": asdict(TUNING)},
        artefacts=draw_artefacts(run.trace, run.pair, items) if want_artefacts else (),
        colours=run.trace.colours,
        second_place=run.trace.second_place,
    )


@dataclass(frozen=True, slots=True)
class _Run:
    """One attempt: the photographs measured, and the items or why there are none."""

    pair: PhotoPair
    trace: Trace
    outcome: tuple[ItemEstimate, ...] | Failure


def _run_with_fallbacks(pair: PhotoPair, options: EstimateOptions, stage: Stages) -> _Run:
    """Run with the best partner of the left photograph; while that fails, with the next, or as the phone paired them.

    A run by the marker alone counts only if no partner has matches. If all fail, fallbacks are tried. Unless one of
    them succeeds, the failure is that of the pair as it was sent.
    """
    unmatched: _Run | None = None
    tried = [pair]
    if pair.others and options.marker is not None:
        with stage("marker"):
            tried = stereo_partners(pair, options.marker)
    photos = [pair.right, *pair.others]
    for each in tried:
        place = next(index for index, photo in enumerate(photos, start=1) if photo is each.right)
        run = _run(each, options, Trace(stage, second_place=place))
        if not isinstance(run.outcome, Failure):
            if not run.trace.is_by_marker_alone:
                return run
            unmatched = unmatched or run
        if each.right is pair.right:
            failed = run
    if unmatched is not None:
        return unmatched
    if isinstance(failed.outcome, Failure):
        for other_pair, other_options in _fallbacks(failed.outcome, failed.trace, pair, options):
            trace = Trace(stage, markers=failed.trace.markers, colours=failed.trace.colours)
            fallback = _run(other_pair, other_options, trace)
            if not isinstance(fallback.outcome, Failure):
                return fallback
    return failed


def _fallbacks(
    failure: Failure, trace: Trace, pair: PhotoPair, options: EstimateOptions
) -> Iterator[tuple[PhotoPair, EstimateOptions]]:
    """The left photograph alone by its depth map where the pair is unusable; the poses where no marker is seen.

    If the poses do not help, and the left photograph shows the marker, that one is measured alone.
    """
    if failure.code in PAIR_UNUSABLE and _may_be_measured_alone(pair, options):
        yield PhotoPair(pair.left), options
    if failure.code in MARKER_UNSEEN and options.poses and pair.right is not None:
        yield pair, replace(options, marker=None)
        if trace.markers[0] is not None and options.method == "shape":
            yield PhotoPair(pair.left), options


def _run(pair: PhotoPair, options: EstimateOptions, trace: Trace) -> _Run:
    outcome = _run_steps(pair, options, trace)
    is_doubtful = _may_be_measured_alone(pair, options) or not _is_confirmed(outcome)
    is_doubtful |= options.method == "paper-strict"  # whose F the marker's plane alone leaves open
    if trace.matches is not None and trace.is_by_marker_alone and is_doubtful:
        outcome = too_few_matches(trace.matches.beside_board)
        trace.items, trace.printed = [], None
    return _Run(pair, trace, outcome)


def _may_be_measured_alone(pair: PhotoPair, options: EstimateOptions) -> bool:
    """Return whether the left photograph has a depth map and a marker: it needs no other one."""
    return pair.left.depth is not None and options.marker is not None and options.method == "shape"


def _is_confirmed(outcome: tuple[ItemEstimate, ...] | Failure) -> bool:
    """Return whether a food's surface was measured, which shows that both photographs are of one scene at rest.

    A failure for another reason stays what it is.
    """
    if isinstance(outcome, Failure):
        return outcome.code not in UNMEASURED
    return any(item.volume_ml is not None and "low_texture" not in item.flags for item in outcome)


def _run_steps(
    pair: PhotoPair, options: EstimateOptions, trace: Trace
) -> tuple[ItemEstimate, ...] | Failure:
    placed = place_views(pair, options, trace)
    if isinstance(placed, Failure):
        return placed
    trace.scale = placed.scale
    views, scene = reconstruct_over_table(placed.views, trace)
    placed, trace.scene = replace(placed, views=views), scene
    if placed.marker is not None:
        if pair.others and isinstance(views, RefinedViews):
            with trace.stage("match"):
                trace.others = place_other_views(pair.others, views, options)
        moved = judge_table(placed.marker.spec, plane_points(scene.rectified), scene.points_table)
        if moved is not None:
            return moved
    if options.method == "shape":
        with trace.stage("depth"):
            trace.scene = scene = add_depths(scene, views, trace.others)
    with trace.stage("segment"):
        left = views.second if trace.is_swapped and isinstance(views, RefinedViews) else views.first
        places = photograph_px(
            scene.rectified, scene.points_table, left, is_swapped=trace.is_swapped
        )
        size = (pair.left.pixels_bgr.shape[1], pair.left.pixels_bgr.shape[0])
        hints = draw_hints(options.hints, places, size)
        foods = segment_meal(
            scene.rectified, scene.disparity, scene.points_table, scene.is_ignored, hints, options
        )
        if isinstance(foods, Failure):
            return foods
        trace.foods = foods
    with trace.stage("volume"):
        likely = (
            _likely_forms(foods, places, pair, options, trace)
            if isinstance(views, SingleView)
            else []
        )
        measured = _measure(foods, placed, scene, options, trace, likely)
        if isinstance(measured, Failure):
            return measured
        trace.items = measured
    with trace.stage("describe"):
        outlines = [
            rings_of(item.region.mask, places, is_swapped=trace.is_swapped) for item in measured
        ]
        items = _describe(measured, outlines, pair, scene, trace)
        return items + _missed(options.hints, items)


def _likely_forms(
    foods: Foods, places: Float32Array, pair: PhotoPair, options: EstimateOptions, trace: Trace
) -> list[LikelyForms | None]:
    """The forms that each region may have by its looks in a single view, where its outline hardly tells.

    None where a hint tells, or nothing can be described.
    """
    if options.forms_by_looks is None:
        return []
    likely: list[LikelyForms | None] = []
    for region in foods.regions:
        vector = None
        hint = options.hints[region.hint] if region.hint is not None else None
        if form_prior(hint) is None:
            rings = rings_of(region.mask, places, is_swapped=False)
            vector = describe_rings(pair.left.pixels_bgr, rings, trace.colour_of(0))
        likely.append(
            LikelyForms(options.forms_by_looks(vector.astype(np.float64)))
            if vector is not None
            else None
        )
    return likely


def _measure(
    foods: Foods,
    placed: Placement,
    scene: Reconstruction,
    options: EstimateOptions,
    trace: Trace,
    likely: Sequence[LikelyForms | None],
) -> list[MeasuredItem] | Failure:
    """Volumes by the method asked for, with the doubt that poses, lenses and scale leave; a single view's by shapes."""
    doubt = doubt_volumes(placed, scene, foods.mask)
    if isinstance(doubt, Failure):
        return doubt
    sd, flags = doubt
    if trace.is_by_marker_alone:
        flags = (*flags, "few_matches")
    pair, disparity, points, hints = (
        scene.rectified,
        scene.disparity,
        scene.points_table,
        options.hints,
    )
    measured: list[MeasuredItem] | Failure
    if options.method == "shape" or isinstance(placed.views, SingleView):
        trace.table = foods.table
        others = [undistorted_view(view, pair.focal_px) for view in trace.others]
        measured = measure_shapes(
            foods,
            pair,
            disparity,
            points,
            pose_sd=sd,
            hints=hints,
            others=others,
            depths=scene.depths,
            likely=likely,
        )
    elif options.method == "paper":
        measured = measure_items(
            foods.regions, pair, disparity, points, scene.is_ignored, hints, pose_sd=sd
        )
    else:
        measured = _measure_as_printed(foods, placed.views, scene, options, trace)
    if isinstance(measured, Failure):
        return measured
    if isinstance(placed.views, SingleView):
        measured = [
            of_single_view(item, hints[item.region.hint] if item.region.hint is not None else None)
            for item in measured
        ]
    return [replace(item, flags=(*item.flags, *flags, *scene.flags)) for item in measured]


def _measure_as_printed(
    foods: Foods, views: RefinedViews, scene: Reconstruction, options: EstimateOptions, trace: Trace
) -> list[MeasuredItem] | Failure:
    """Volumes by the founding paper to the letter; of what stands above, the foods' masks alone take part."""
    if trace.matches is None or views.first.marker is None:
        raise ValueError(
            "The method paper-strict takes its tie points from a marker, not from a rig."
        )
    masks, rng = [region.mask for region in foods.regions], np.random.default_rng(options.seed)
    stereo = reconstruct_as_printed(views, trace.matches, scene.rectified, masks, rng)
    if isinstance(stereo, Failure):
        return stereo
    trace.printed = stereo
    return measure_as_printed(foods.regions, stereo, options.hints)


def _describe(
    measured: Sequence[MeasuredItem],
    outlines: Sequence[tuple[Float64Array, ...]],
    pair: PhotoPair,
    scene: Reconstruction,
    trace: Trace,
) -> tuple[ItemEstimate, ...]:
    """The measured foods with their looks in the corrected colours."""
    colour, left_colour = trace.colour_of(0), trace.colour_of(1 if trace.is_swapped else 0)
    return tuple(
        ItemEstimate(
            rings=rings,
            volume_ml=item.volume.volume_ml if item.volume is not None else None,
            volume_interval_ml=item.volume.interval_ml if item.volume is not None else None,
            relative_sd=item.volume.relative_sd if item.volume is not None else {},
            hint=item.region.hint,
            flags=item.flags,
            traits=traits_of(
                item.region.mask, scene.points_table, scene.rectified.first_bgr, colour
            ),
            vcm=describe_rings(pair.left.pixels_bgr, rings, left_colour),
        )
        for item, rings in zip(measured, outlines, strict=True)
    )


def _missed(hints: Sequence[Hint], items: Sequence[ItemEstimate]) -> tuple[ItemEstimate, ...]:
    """An item without outline and volume for each hint at whose place nothing could be measured."""
    answered = {item.hint for item in items}
    flags = ("not_measurable", "hint_missed")
    return tuple(
        ItemEstimate(
            rings=(),
            volume_ml=None,
            volume_interval_ml=None,
            relative_sd={},
            hint=index,
            flags=flags,
        )
        for index, hint in enumerate(hints)
        if hint.has_place and index not in answered
    )
