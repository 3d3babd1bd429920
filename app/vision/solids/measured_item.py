"""A measured food: its volume with interval and shape, or that it is there and cannot be measured.

Items of any method -> those that are given out: without clutter, and without volumes whose interval says nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.believable import WIDEST, says_nothing
from app.core.errors import Failure
from app.vision.geometry.mesh import ClosedShape
from app.vision.geometry.slices import Slice
from app.vision.model import Float64Array, Hint, MaskArray, SliceForm
from app.vision.scene.segmentation import Region
from app.vision.tuning import TUNING
from app.vision.views.sight import Sight

SCALE_SD = 0.005  # of the print's side, relative; cubed in a volume
NORMAL_90 = 1.645
MOST_SD = math.log(WIDEST) / NORMAL_90  # relative; beyond, the interval says nothing
MIN_VOLUME_ML = 3.0  # less than half a cherry tomato, and not pointed at: clutter
# relative: no form explains what was cut out, and nobody pointed at it: a part of a dish
UNEXPLAINED_SD = 0.5
HELD_FORMS = frozenset({"liquid", "in_vessel"})  # what holds them is not seen in a single view
LOW_COVER = 0.5  # share of the mask that was measured, below which the estimate is flagged


@dataclass(frozen=True, slots=True)
class Volume:
    """A food's volume and how it came about.

    interval_ml: 90 %.
    relative_sd: see ItemEstimate.
    form: that the slices were fitted with.
    centre_mm: (2,) on the table, of the food.
    slices: from the support upwards.
    completed_mm: (n, 3) points of the food's surface, z from the support.
    shape: the closed surface that stands for the food. It holds volume_ml, unless that is an average over several
        shapes (the default method), of which it is the likeliest.
    """

    volume_ml: float
    interval_ml: tuple[float, float]
    relative_sd: dict[str, float]
    form: SliceForm
    centre_mm: Float64Array
    slices: tuple[Slice, ...]
    completed_mm: Float64Array
    shape: ClosedShape


@dataclass(frozen=True, slots=True)
class MeasuredItem:
    """A food with its mask on the rectified grid, the points measured, its support's height and its volume.

    volume: None where the food is there and how much of it is not to be seen. sight: how the views see points about
    it, if it was measured by that; None: by the poses alone. seen_again: how clear its outline is in the second view,
    where its form puts it, over how clear in the first; None where that is not known.
    """

    region: Region
    points_table: Float64Array
    support_mm: float
    volume: Volume | None
    flags: tuple[str, ...]
    sight: Sight | None = None
    seen_again: float | None = None

    @property
    def shows_rest(self) -> bool:
        """Return whether both photographs show it in one place: by its outline, without one by its surface."""
        if self.volume is None:
            return False
        if self.seen_again is None:
            return "low_texture" not in self.flags
        return self.seen_again > TUNING.least_seen_again


def of_single_view(item: MeasuredItem, hint: Hint | None) -> MeasuredItem:
    """Return the item with the flag, and without its volume where a vessel holds it: its depth is not seen."""
    is_alone = "view_from_side" not in item.flags
    flagged = replace(item, flags=(*item.flags, "single_view")) if is_alone else item
    if item.volume is None:
        return flagged
    is_held = hint is not None and (
        hint.vessel is not None or bool(HELD_FORMS & {hint.form, hint.lies_as, hint.usual_form})
    )
    return not_measurable(flagged) if is_held else flagged


def not_measurable(item: MeasuredItem) -> MeasuredItem:
    """Return the item without its volume, with the flag."""
    return replace(item, volume=None, flags=(*item.flags, "not_measurable"))


def without_clutter(measured: Sequence[MeasuredItem | None]) -> list[MeasuredItem] | Failure:
    """Return the measured foods without those too small to be one that nobody pointed at; or why there are none.

    A volume whose interval says nothing is left out, as is that of a form which the second view does not have.
    """
    items = [item for item in measured if item is not None and not _is_clutter(item)]
    if not items and all(item is not None for item in measured):
        return Failure(
            "no_food_found",
            f"Nothing larger than {MIN_VOLUME_ML:g} ml was found.",
            "If food lies there, photograph it at a slant of about 45 degrees with the whole plate in both views, or "
            "mark it.",
        )
    return [not_measurable(item) if _has_no_volume(item) else item for item in items] or Failure(
        "food_not_measured",
        "Food was found, but its surface could not be measured: it looks too plain or too different in the two views.",
        "Take both photographs closer together, sharp, in even light, and avoid glare on the food.",
    )


def is_low_texture(is_measured: MaskArray, mask: MaskArray) -> bool:
    """Whether so little of a food's mask was measured that its volume is flagged. Both (H, W)."""
    return bool(np.count_nonzero(is_measured & mask) < LOW_COVER * np.count_nonzero(mask))


def _has_no_volume(item: MeasuredItem) -> bool:
    if item.volume is None:
        return False
    was_moved = item.seen_again is not None and not item.shows_rest
    return was_moved or says_nothing(item.volume.volume_ml, *item.volume.interval_ml)


def _is_clutter(item: MeasuredItem) -> bool:
    if item.region.hint is not None or item.volume is None:
        return False
    return (
        item.volume.volume_ml < MIN_VOLUME_ML
        or item.volume.relative_sd.get("item", 0.0) > UNEXPLAINED_SD
    )
