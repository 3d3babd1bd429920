"""From a food's mask to its volume: the points that are surely its own, its support, its outline as a limit.

Regions of the rectified grid and its points -> measured items. Slices and doubt are for volume.py, pixels for
segmentation.py.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.believable import says_nothing
from app.core.errors import Failure
from app.vision.geometry.masks import dilated, inward_px
from app.vision.model import Float32Array, Float64Array, Hint, MaskArray
from app.vision.scene.segmentation import Region
from app.vision.scene.support import support_height_mm
from app.vision.solids.volume import Volume, estimate_volume
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import RectifiedPair
from app.vision.views.sight import Sight

# of half a fine window: it follows the surface, and shows the outline's points best
FINE_REACH_SHARE = 0.5
FINEST_REACH_PX = 5.0
OUTLINE_MARGIN_PX = 2  # by which a mask may be too small
MIN_VOLUME_ML = 3.0  # less than half a cherry tomato, and not pointed at: clutter
# relative: no form explains what was cut out, and nobody pointed at it: a part of a dish
UNEXPLAINED_SD = 0.5
HELD_FORMS = frozenset({"liquid", "in_vessel"})  # what holds them is not seen in a single view
LOW_COVER = 0.5  # share of the mask that was measured, below which the estimate is flagged


@dataclass(frozen=True, slots=True)
class MeasuredItem:
    """A food with its mask on the rectified grid, the points measured, its support's height and its volume.

    volume: None where the food is there and how much of it is not to be seen. sight: how the views see points about
    it, if it was measured by that; None: by the poses alone.
    """

    region: Region
    points_table: Float64Array
    support_mm: float
    volume: Volume | None
    flags: tuple[str, ...]
    sight: Sight | None = None


def of_single_view(item: MeasuredItem, hint: Hint | None) -> MeasuredItem:
    """Return the item with the flag, and without its volume where a vessel holds it: its depth is not seen."""
    flagged = replace(item, flags=(*item.flags, "single_view"))
    if item.volume is None:
        return flagged
    is_held = hint is not None and (
        hint.vessel is not None or bool(HELD_FORMS & {hint.form, hint.lies_as, hint.usual_form})
    )
    return not_measurable(flagged) if is_held else flagged


def not_measurable(item: MeasuredItem) -> MeasuredItem:
    """Return the item without its volume, with the flag."""
    return replace(item, volume=None, flags=(*item.flags, "not_measurable"))


def measure_items(
    regions: Sequence[Region],
    pair: RectifiedPair,
    disparity: DisparityMap,
    points_table: Float32Array,
    ignored: MaskArray,
    hints: Sequence[Hint],
    *,
    pose_sd: float,
) -> list[MeasuredItem] | Failure:
    """Volumes of the foods that can be measured, in the regions' order. Failure "food_not_measured" if there is none.

    ignored: (H, W) the sheet and what is not seen. pose_sd: see volume.estimate_volume.
    """
    foods = np.any([region.mask for region in regions], axis=0)
    return without_clutter(
        [
            _measure(
                region,
                pair,
                disparity,
                points_table,
                ignored | (foods & ~region.mask),
                hints,
                pose_sd,
            )
            for region in regions
        ]
    )


def without_clutter(measured: Sequence[MeasuredItem | None]) -> list[MeasuredItem] | Failure:
    """Return the measured foods without those too small to be one that nobody pointed at; or why there are none.

    A volume whose interval says nothing is left out.
    """
    items = [item for item in measured if item is not None and not _is_clutter(item)]
    if not items and all(item is not None for item in measured):
        return Failure(
            "no_food_found",
            f"Nothing larger than {MIN_VOLUME_ML:g} ml was found.",
            "If food lies there, photograph it at a slant of about 45 degrees with the whole plate in both views, or "
            "mark it.",
        )
    return [not_measurable(item) if _says_nothing(item) else item for item in items] or Failure(
        "food_not_measured",
        "Food was found, but its surface could not be measured: it looks too plain or too different in the two views.",
        "Take both photographs closer together, sharp, in even light, and avoid glare on the food.",
    )


def is_low_texture(is_measured: MaskArray, mask: MaskArray) -> bool:
    """Whether so little of a food's mask was measured that its volume is flagged. Both (H, W)."""
    return bool(np.count_nonzero(is_measured & mask) < LOW_COVER * np.count_nonzero(mask))


def _says_nothing(item: MeasuredItem) -> bool:
    return item.volume is not None and says_nothing(item.volume.volume_ml, *item.volume.interval_ml)


def _is_clutter(item: MeasuredItem) -> bool:
    if item.region.hint is not None or item.volume is None:
        return False
    return (
        item.volume.volume_ml < MIN_VOLUME_ML
        or item.volume.relative_sd.get("item", 0.0) > UNEXPLAINED_SD
    )


def _measure(
    region: Region,
    pair: RectifiedPair,
    disparity: DisparityMap,
    points_table: Float32Array,
    others: MaskArray,
    hints: Sequence[Hint],
    pose_sd: float,
) -> MeasuredItem | None:
    is_measured = np.isfinite(points_table[..., 2])
    # Near the outline a window may have matched what lies behind; the larger the window, the further in.
    reach = (
        np.where(disparity.reach_px < FINEST_REACH_PX, FINE_REACH_SHARE, 1.0) * disparity.reach_px
    )
    depth_px = inward_px(region.mask)
    points = points_table[is_measured & (depth_px > reach)].astype(np.float64)
    support = support_height_mm(points_table, region.mask, others)
    form = hints[region.hint].slice_form if region.hint is not None else None
    volume = estimate_volume(
        points,
        support or 0.0,
        form,
        pair.first_centre_mm,
        outline_test(pair, region.mask),
        pose_sd=pose_sd,
    )
    if volume is None:
        return None
    flags = []
    if support is None:
        flags.append("support_not_measured")
    if is_low_texture(is_measured, region.mask):
        flags.append("low_texture")
    return MeasuredItem(region, points, support or 0.0, volume, tuple(flags))


def outline_test(pair: RectifiedPair, mask: MaskArray) -> Callable[[Float64Array], MaskArray]:
    """A test whether points (n, 3), table frame, mm, project into the mask; outside the grid nothing is known: True."""
    grown = dilated(mask, 2 * OUTLINE_MARGIN_PX + 1)
    height, width = mask.shape

    def is_in_outline(points: Float64Array) -> MaskArray:
        columns, rows = np.rint(pair.project(points)[:, :2]).astype(np.int64).T
        on_grid = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        inside = np.ones(len(points), np.bool_)
        inside[on_grid] = grown[rows[on_grid], columns[on_grid]]
        return inside

    return is_in_outline
