"""The volumes of a scene's foods by the method asked for, with the doubt that the views leave.

Foods and points over the table -> measured items, in the foods' order. A single view is always
measured by solids.
"""

from collections.abc import Sequence
from dataclasses import replace

from app.core.errors import Failure
from app.vision.board.camera import camera_from_exif
from app.vision.looks.food_again import find_again
from app.vision.looks.vcm_region import region_of_rings
from app.vision.model import EstimateOptions, Float32Array, Hint, Photo
from app.vision.paper.depth_slices import measure_as_printed
from app.vision.paper.measure_items import measure_items
from app.vision.scene.segmentation import Foods
from app.vision.solids.form_prior import LikelyForms, likely_forms
from app.vision.solids.measured_item import MeasuredItem, of_single_view
from app.vision.solids.outlines import rings_of
from app.vision.solids.shape import measure_shapes
from app.vision.solids.side_view import SideView, side_view
from app.vision.trace import Trace
from app.vision.views.pinhole_view import undistorted_view
from app.vision.views.placement import Placement, doubt_volumes
from app.vision.views.reconstruction import Reconstruction
from app.vision.views.single_view import SingleView


def measure_foods(
    foods: Foods,
    placed: Placement,
    scene: Reconstruction,
    left: Photo,
    places: Float32Array,
    options: EstimateOptions,
    trace: Trace,
) -> list[MeasuredItem] | Failure:
    """Measure the foods. places: (H, W, 2) px, where the grid's pixels lie in the left photograph.

    Failures: "focal_unknown", "no_food_found", "food_not_measured", and those of the paper's
    stereo.
    """
    doubt = doubt_volumes(placed, scene, foods.mask)
    if isinstance(doubt, Failure):
        return doubt
    pose_sd, flags = doubt
    if trace.is_by_marker_alone:
        flags = (*flags, "few_matches")
    views, hints = placed.views, options.hints
    measured: list[MeasuredItem] | Failure
    if isinstance(views, SingleView):
        likely = likely_forms(foods, left, places, trace.colour_of(0), options)
        sides = _from_side(foods, left, places, placed.side)
        measured = _by_solids(foods, scene, hints, trace, pose_sd, likely, sides)
    elif options.method == "shape":
        measured = _by_solids(foods, scene, hints, trace, pose_sd)
    elif options.method == "paper":
        measured = measure_items(foods.regions, scene, hints, pose_sd=pose_sd)
    else:
        measured, trace.printed = measure_as_printed(
            foods.regions, views, trace.matches, scene.rectified, options
        )
    if isinstance(measured, Failure):
        return measured
    if isinstance(views, SingleView):
        measured = [of_single_view(item, _hint_of(item, hints)) for item in measured]
    return [replace(item, flags=(*item.flags, *flags, *scene.flags)) for item in measured]


def _by_solids(
    foods: Foods,
    scene: Reconstruction,
    hints: Sequence[Hint],
    trace: Trace,
    pose_sd: float,
    likely: Sequence[LikelyForms | None] = (),
    sides: Sequence[SideView | None] = (),
) -> list[MeasuredItem] | Failure:
    trace.table = foods.table
    focal_px = scene.rectified.focal_px
    return measure_shapes(
        foods,
        scene.rectified,
        scene.disparity,
        scene.points_table,
        pose_sd=pose_sd,
        hints=hints,
        others=[undistorted_view(view, focal_px) for view in trace.others],
        depths=scene.depths,
        likely=likely,
        sides=sides,
    )


def _from_side(
    foods: Foods, left: Photo, places: Float32Array, side: Photo | None
) -> list[SideView | None]:
    """Return each food in the photograph from the side; none without one."""
    if side is None:
        return []
    shown = [
        region_of_rings(left.pixels_bgr, rings_of(region.mask, places, is_swapped=False))
        for region in foods.regions
    ]
    again = find_again(shown, [region.hint is not None for region in foods.regions], side)
    focal_px = camera_from_exif(side).fx
    return [None if each is None else side_view(each.mask, focal_px * each.scale) for each in again]


def _hint_of(item: MeasuredItem, hints: Sequence[Hint]) -> Hint | None:
    return hints[item.region.hint] if item.region.hint is not None else None
