"""Liquids beside the foods of a meal: filled vessels are found first, and the foods in what they leave.

The rectified pair -> regions of liquids and of foods, with hints shared out between them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.core.errors import Failure
from app.vision.geometry.masks import dilated
from app.vision.geometry.topview import fit_table_trend, usable_points
from app.vision.model import EstimateOptions, Float32Array, Hint, MaskArray
from app.vision.scene.filled_vessel import FilledVessel, StandingVessel, Vessels, find_vessels
from app.vision.scene.segmentation import Foods, HintMask, Region, segment_foods
from app.vision.scene.support import Support
from app.vision.vessel_library import VesselModel
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import RectifiedPair

REDUCTION = 4  # of the grid, for the table's trend
BESIDE_PX = 9  # around a vessel, where dense parallax is its own
# Height by radius of the rim, from which on a vessel is a cup and no bowl, which has no handle.
HANDLED_ASPECT = 0.7
# of the rim's radius, across the plane through the vessel's axis in which a handle lies
HANDLE_WIDTH = 0.6
HANDLE_BEGIN = 1.4  # of the rim's radius, from the axis: it is fixed to the wall
HANDLE_CLEARANCE = 0.15  # of the rim's height over what lies under a handle, table or dish, to the handle's low end
HANDLE_MIN_POINTS = 50  # measured, before they tell what a region is
UNREAD_SHARE = 0.4  # of a region and such a vessel that they share to be one
SHARE_OF_BOX = 0.3  # of a hint's box that a vessel must fill to be what it points at
SHARE_OF_CONTENT = 0.3  # of a vessel's content that a person's outline takes for its own


def segment_meal(
    pair: RectifiedPair,
    disparity: DisparityMap,
    points_table: Float32Array,
    ignored: MaskArray,
    hints: Sequence[HintMask],
    options: EstimateOptions,
) -> Foods | Failure:
    """Foods and liquids, liquids first. See segment_foods for shapes, units and failures.

    The paper's method has no vessels: all is food to it, as it is and as printed. A rim's height takes two views: a
    single one shows none.
    """
    is_table_sure = options.marker is not None

    def foods_beside(vessels: MaskArray | None, sought: Sequence[HintMask]) -> Foods | Failure:
        return segment_foods(
            pair,
            disparity,
            points_table,
            ignored,
            sought,
            vessels,
            is_complete=options.is_complete,
            is_table_sure=is_table_sure,
            has_judge=options.method == "shape",
        )

    if options.method != "shape" or pair.second_bgr is None:
        return foods_beside(None, hints)
    every = slice(None, None, REDUCTION)
    points, unseen = (
        np.ascontiguousarray(points_table[every, every]),
        np.ascontiguousarray(ignored[every, every]),
    )
    table = fit_table_trend(points[usable_points(points, unseen)])
    vessels = find_vessels(pair, points_table, table, ignored, options.vessels)
    liquids, taken = _liquids(vessels, hints, options)
    answered = {region.hint for region in liquids}
    rest = [hint for hint in hints if hint.index not in answered]
    if liquids and options.is_complete and not rest:
        return Foods(liquids, table)
    foods = foods_beside(dilated(taken, BESIDE_PX), rest) if liquids else foods_beside(None, hints)
    if isinstance(foods, Failure):
        return Foods(liquids, table) if liquids else foods
    regions = [
        replace(region, is_unread=_is_unread(region, vessels.unread))
        for region in foods.regions
        if region.hint is not None or not _is_part_of_vessel(region, points_table, vessels)
    ]
    return replace(foods, regions=[*liquids, *regions])


def _liquids(
    vessels: Vessels, hints: Sequence[HintMask], options: EstimateOptions
) -> tuple[list[Region], MaskArray]:
    """The liquids that are measured, with the hints that they answer, and (H, W) their vessels."""
    liquids: list[Region] = []
    taken: MaskArray | np.bool_ = np.False_
    for vessel in vessels.filled:
        hint = _hint_of(vessel, hints)
        if hint is None and (options.is_complete or _is_drawn(vessel, hints)):
            continue
        named = (
            vessel
            if hint is None
            else _as_named(vessel, options.hints[hint.index], options.vessels)
        )
        taken = taken | vessel.silhouette
        liquids.append(Region(vessel.content, None if hint is None else hint.index, liquid=named))
    return liquids, np.asarray(taken, np.bool_)


def _is_part_of_vessel(region: Region, points_table: Float32Array, vessels: Vessels) -> bool:
    """Return whether a region is a vessel's handle."""
    points = points_table[region.mask]
    points = points[np.isfinite(points[:, 2])]
    return any(
        _is_handle(points, vessel, region.support) for vessel in [*vessels.filled, *vessels.unread]
    )


def _is_handle(
    points_table: Float32Array, vessel: StandingVessel, support: Support | None = None
) -> bool:
    """Return whether points (n, 3), mm, are a vessel's handle: a loop or strap that no food is like.

    It is fixed to the wall, narrow across a plane through the vessel's axis, and clear of the surface on which a food
    would lie. support: that surface, a dish's where it is higher than the table.
    """
    under_mm = vessel.table_mm if support is None else max(vessel.table_mm, support.height_mm)
    height_mm = vessel.rim.height_mm - under_mm
    if len(points_table) < HANDLE_MIN_POINTS or height_mm < HANDLED_ASPECT * vessel.rim.radius_mm:
        return False
    apart = points_table[:, :2] - vessel.rim.centre_mm
    reach = np.linalg.norm(apart, axis=1)
    outward = np.median(apart / np.maximum(reach, 1e-3)[:, None], axis=0)
    across = apart @ np.array([-outward[1], outward[0]]) / max(float(np.linalg.norm(outward)), 1e-3)
    left, right = np.quantile(across, (0.05, 0.95))
    low_mm = float(np.quantile(points_table[:, 2], 0.05)) - under_mm
    return bool(
        right - left < HANDLE_WIDTH * vessel.rim.radius_mm
        and np.quantile(reach, 0.05) < HANDLE_BEGIN * vessel.rim.radius_mm
        and low_mm > HANDLE_CLEARANCE * height_mm
    )


def _is_unread(region: Region, vessels: Sequence[StandingVessel]) -> bool:
    """Whether a region is a vessel in which no surface is seen, a glass of water: what stereo makes of it is chance."""
    return any(
        np.count_nonzero(region.mask & vessel.silhouette)
        > UNREAD_SHARE * np.count_nonzero(region.mask | vessel.silhouette)
        for vessel in vessels
    )


def _hint_of(vessel: FilledVessel, hints: Sequence[HintMask]) -> HintMask | None:
    """The hint that points at the vessel's content; an exact outline is the person's own and stays a food's."""
    for hint in hints:
        if hint.is_exact:
            continue
        shared = np.count_nonzero(hint.mask & vessel.silhouette)
        if shared > (SHARE_OF_BOX * np.count_nonzero(hint.mask) if hint.is_box else 0):
            return hint
    return None


def _is_drawn(vessel: FilledVessel, hints: Sequence[HintMask]) -> bool:
    """Whether a person drew the vessel's content: then their outline is the food."""
    area = np.count_nonzero(vessel.content)
    return any(
        hint.is_exact and np.count_nonzero(hint.mask & vessel.content) > SHARE_OF_CONTENT * area
        for hint in hints
    )


def _as_named(vessel: FilledVessel, hint: Hint, library: Sequence[VesselModel]) -> FilledVessel:
    """The vessel measured as the library's vessel that the hint names, if it names one."""
    named = [model for model in library if model.name == hint.vessel]
    return vessel.measured_as(named[0]) if named else vessel
