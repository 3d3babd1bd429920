"""From placed views to the scene's points over the table: rectified pair, disparity, depth, and depth maps with it.

A single view's parallax is its depth map's, if it has one. Depth maps and a further match join a pair's parallax if the
table that they show is the reference's; else they are left out, with the flag "depth_ignored". The scale stays that of
the marker or the rig.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.core.errors import Failure
from app.vision.model import EstimateOptions, MaskArray, Photo, View
from app.vision.stages import Stages
from app.vision.tuning import TUNING
from app.vision.views.aligned_depth import depth_in_view
from app.vision.views.depth_fusion import agree_with_table, fuse_depths
from app.vision.views.depth_parallax import parallax_of_depth, parallax_of_match
from app.vision.views.disparity import DisparityMap, match_dense, unmatched
from app.vision.views.features import shows_sheet
from app.vision.views.marker_thickness import find_thickness, on_plaque
from app.vision.views.other_views import place_other_views, second_pair
from app.vision.views.placement import Placement
from app.vision.views.reconstruction import (
    Reconstruction,
    back_project,
    fit_to_marker,
    ideal_depth,
    plane_points,
)
from app.vision.views.rectification import RectifiedPair, rectify_alone, rectify_by_poses
from app.vision.views.relative_pose import RefinedViews
from app.vision.views.single_view import SingleView
from app.vision.views.stillness import judge_table
from app.vision.views.views_trace import ViewsTrace

BESIDE_OBJECT_MM = 2.0  # around a known object: its edge and its shadow
TABLE_MM = 8.0  # over or under the marker's plane: where a pair's points tell how far the table is


def reconstruct_scene(
    placed: Placement, others: Sequence[Photo], options: EstimateOptions, trace: ViewsTrace
) -> tuple[Placement, Reconstruction] | Failure:
    """The scene of placed views, with all depth that the method uses; and the views in its table's frame.

    others: further photographs. Failure "scene_moved".
    """
    views, scene = _over_table(placed.views, trace)
    placed, trace.scene = replace(placed, views=views), scene
    if placed.marker is not None:
        if others and isinstance(views, RefinedViews):
            with trace.stage("match"):
                trace.others = place_other_views(others, views, options)
        moved = judge_table(placed.marker.spec, plane_points(scene.rectified), scene.points_table)
        if moved is not None:
            return moved
    if options.method == "shape" and isinstance(views, RefinedViews):
        with trace.stage("depth"):
            trace.scene = scene = _with_depths(scene, views, trace.others)
    return placed, scene


def _over_table(
    views: RefinedViews | SingleView, trace: ViewsTrace
) -> tuple[RefinedViews | SingleView, Reconstruction]:
    """The scene, and the views in its table's frame, which lies deeper where a plaque turns out to carry the print."""
    scene = _reconstruct(views, trace.stage)
    marker = views.first.marker
    if isinstance(views, SingleView) or marker is None or marker.spec.thick_mm != 0:
        return views, scene
    with trace.stage("depth"):
        thick_mm = find_thickness(marker.spec, scene.table_points())
    if thick_mm <= 0:
        return views, scene
    views = on_plaque(views, thick_mm)
    trace.keep_views(views)
    return views, _reconstruct(views, trace.stage)


def _with_depths(
    scene: Reconstruction, refined: RefinedViews, others: Sequence[View]
) -> Reconstruction:
    """A pair's scene with its depth maps and the match of a further pair of views."""
    pair, match = scene.rectified, scene.disparity
    is_table = np.abs(scene.points_table[..., 2]) < TABLE_MM
    # What a phone made of its own two lenses knows less than the pair does, and may be smoothed.
    maps = [
        parallax_of_depth(pair, view, view.photo.depth)
        for view in (refined.first, refined.second)
        if view.photo.depth is not None and not view.photo.depth.is_aligned
    ]
    levelled_maps = [
        agree_with_table(pair, parallax, match.parallax_px, is_table, has_tilt=True)
        for parallax in maps
    ]
    agreed_maps = tuple(parallax for parallax in levelled_maps if parallax is not None)
    flags = ("depth_ignored",) if len(agreed_maps) < len(maps) else ()
    matches = _further_match(scene, second_pair(refined.first, refined.second, others), is_table)
    depths = (*agreed_maps, *matches)
    if not depths:
        return replace(scene, flags=flags)
    fused = fuse_depths(pair, match, matches, TUNING.dense_sd_px, is_averaged=True)
    fused = fuse_depths(pair, fused, agreed_maps, TUNING.dense_sd_px, is_averaged=False)
    disparity_px = pair.disparity_from_parallax(fused.parallax_px)
    points = back_project(pair, scene.depth.depth_mm(disparity_px))
    return replace(scene, disparity=fused, points_table=points, depths=depths, flags=flags)


def _further_match(
    scene: Reconstruction, further_views: tuple[View, View] | None, is_table: MaskArray
) -> tuple[DisparityMap, ...]:
    """The dense match of two further views on the pair's grid; none where its table is not the pair's."""
    if further_views is None:
        return ()
    pair, further_pair = scene.rectified, rectify_by_poses(*further_views)
    match = match_dense(
        *further_pair.both_bgr, further_pair.parallax_range_px, further_pair.is_seen
    )
    on_grid = parallax_of_match(pair, further_pair, match, TUNING.dense_sd_px)
    agreed = agree_with_table(pair, on_grid, scene.disparity.parallax_px, is_table, has_tilt=True)
    return () if agreed is None else (agreed,)


def _reconstruct(views: RefinedViews | SingleView, stage: Stages) -> Reconstruction:
    """Points in the views' table frame; of a single view without a depth map, none."""
    marker = views.first.marker
    with stage("rectify"):
        if isinstance(views, RefinedViews):
            rectified = rectify_by_poses(views.first, views.second)
        else:
            rectified = rectify_alone(views.first)
    with stage("disparity"):
        sheet = _sheet(rectified, views.first)
        flags: tuple[str, ...] = ()
        if rectified.second_bgr is None:
            disparity, flags = _parallax_alone(rectified, views.first, sheet)
        else:
            disparity = match_dense(
                *rectified.both_bgr, rectified.parallax_range_px, rectified.is_seen
            )
    with stage("depth"):
        if isinstance(views, RefinedViews) and marker is not None:
            depth = fit_to_marker(rectified, views)
        else:
            depth = ideal_depth(rectified)
        depth_mm = depth.depth_mm(rectified.disparity_from_parallax(disparity.parallax_px))
        points = back_project(rectified, depth_mm)
    return Reconstruction(
        rectified, disparity, depth, points, sheet | ~rectified.is_seen, flags=flags
    )


def _sheet(pair: RectifiedPair, view: View) -> MaskArray:
    """Return the pixels (H, W) that show the marker's sheet or the known object; none without either."""
    if view.marker is not None:
        return shows_sheet(view.marker, plane_points(pair), pair.first_centre_mm)
    if view.known is not None:
        apart = np.linalg.norm(plane_points(pair)[..., :2], axis=-1)
        return np.asarray(apart < view.known.diameter_mm / 2 + BESIDE_OBJECT_MM, np.bool_)
    return np.zeros(pair.shape, np.bool_)


def _parallax_alone(
    pair: RectifiedPair, view: View, sheet: MaskArray
) -> tuple[DisparityMap, tuple[str, ...]]:
    """The parallax of a single view by its depth map, in the scale of the marker if there is one, and flags.

    sheet: (H, W) where the marker is seen; nowhere without one.
    """
    if view.photo.depth is None:
        return unmatched(pair.shape), ()
    depth = depth_in_view(view.photo.depth, view)
    if depth is None:
        return unmatched(pair.shape), ("depth_ignored",)
    shown = parallax_of_depth(pair, view, depth)
    if view.marker is None:
        return shown, ()
    print_share = pair.first_centre_mm[2] / (pair.first_centre_mm[2] - view.marker.spec.thick_mm)
    print_px = pair.parallax_from_disparity(pair.plane_disparity_px() * np.float32(print_share))
    agreed = agree_with_table(pair, shown, print_px, sheet, has_tilt=False)
    return (unmatched(pair.shape), ("depth_ignored",)) if agreed is None else (agreed, ())
