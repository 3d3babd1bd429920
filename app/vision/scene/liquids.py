"""Liquids beside the foods of a meal: filled vessels are found first, and the foods in what they leave.

The rectified pair -> regions of liquids and of foods, with hints shared out between them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.core.errors import Failure
from app.vision.geometry.masks import dilated, distance_px, eroded
from app.vision.geometry.topview import fit_table_trend, usable_points
from app.vision.liquids.filled_vessel import FilledVessel, find_vessels
from app.vision.model import EstimateOptions, Float32Array, Hint, MaskArray
from app.vision.scene.segmentation import Foods, HintMask, Region, segment_foods
from app.vision.stereo.disparity import DisparityMap
from app.vision.stereo.rectification import RectifiedPair
from app.vision.vessel_library import VesselModel

REDUCTION = 4  # of the grid, for the table's trend
BESIDE_PX = 9  # around a vessel, where dense parallax is its own
HANDLE_AREA = 0.35  # of a vessel's silhouette, that a handle and what shows through it may be
HANDLE_SHARE, HANDLE_REACH_PX = 0.34, 2 * BESIDE_PX  # of a handle's outline that runs along the vessel; what is along
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
    if options.method != "shape" or pair.second_bgr is None:
        return segment_foods(
            pair, disparity, points_table, ignored, hints, is_complete=options.is_complete, is_table_sure=is_table_sure
        )
    every = slice(None, None, REDUCTION)
    points, unseen = np.ascontiguousarray(points_table[every, every]), np.ascontiguousarray(ignored[every, every])
    table = fit_table_trend(points[usable_points(points, unseen)])
    vessels = find_vessels(pair, points_table, table, ignored, options.vessels)
    taken = np.zeros(ignored.shape, np.bool_)
    liquids: list[Region] = []
    answered: set[int] = set()
    for vessel in vessels.filled:
        hint = _hint_of(vessel, hints)
        if hint is None and (options.is_complete or _is_drawn(vessel, hints)):
            continue
        if hint is not None:
            answered.add(hint.index)
        named = vessel if hint is None else _as_named(vessel, options.hints[hint.index], options.vessels)
        taken |= vessel.silhouette
        liquids.append(Region(vessel.content, None if hint is None else hint.index, liquid=named))
    rest = [hint for hint in hints if hint.index not in answered]
    if liquids and options.is_complete and not rest:
        return Foods(liquids, table)
    around = dilated(taken, BESIDE_PX)
    foods = segment_foods(
        pair,
        disparity,
        points_table,
        ignored,
        rest,
        around,
        is_complete=options.is_complete,
        is_table_sure=is_table_sure,
    )
    if isinstance(foods, Failure):
        return Foods(liquids, table) if liquids else foods
    walls = [(vessel.silhouette, distance_px(vessel.silhouette) <= HANDLE_REACH_PX) for vessel in vessels.filled]
    regions = [
        replace(region, is_unread=_is_unread(region, vessels.unread))
        for region in foods.regions
        if region.hint is not None or not any(_is_handle(region.mask, *wall) for wall in walls)
    ]
    return replace(foods, regions=[*liquids, *regions])


def _is_handle(mask: MaskArray, silhouette: MaskArray, is_beside: MaskArray) -> bool:
    """Return whether a region is a handle of a vessel, or a strip of table seen along its wall.

    All (H, W). is_beside: what lies within reach of the vessel's silhouette.
    """
    if np.count_nonzero(mask) > HANDLE_AREA * np.count_nonzero(silhouette):
        return False
    outline = mask & ~eroded(mask, 3)
    return bool(np.count_nonzero(outline & is_beside) > HANDLE_SHARE * np.count_nonzero(outline))


def _is_unread(region: Region, silhouettes: Sequence[MaskArray]) -> bool:
    """Whether a region is a vessel in which no surface is seen, a glass of water: what stereo makes of it is chance."""
    return any(
        np.count_nonzero(region.mask & vessel) > UNREAD_SHARE * np.count_nonzero(region.mask | vessel)
        for vessel in silhouettes
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
        hint.is_exact and np.count_nonzero(hint.mask & vessel.content) > SHARE_OF_CONTENT * area for hint in hints
    )


def _as_named(vessel: FilledVessel, hint: Hint, library: Sequence[VesselModel]) -> FilledVessel:
    """The vessel measured as the library's vessel that the hint names, if it names one."""
    named = [model for model in library if model.name == hint.vessel]
    return vessel.measured_as(named[0]) if named else vessel
