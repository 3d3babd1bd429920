"""From a food's mask to its volume by the paper: points that are surely its own, its support, its outline as a limit.

Regions of the rectified grid and its points -> measured items. Slices and doubt are for volume.py, pixels for
scene/segmentation.py.
"""

from collections.abc import Callable, Sequence

import numpy as np

from app.core.errors import Failure
from app.vision.geometry.masks import dilated, inward_px
from app.vision.model import Float64Array, Hint, MaskArray, SliceForm
from app.vision.paper.volume import estimate_volume
from app.vision.scene.segmentation import Region
from app.vision.scene.support import support_height_mm
from app.vision.solids.measured_item import MeasuredItem, is_low_texture, without_clutter
from app.vision.views.reconstruction import Reconstruction
from app.vision.views.rectification import RectifiedPair

# of half a fine window: it follows the surface, and shows the outline's points best
FINE_REACH_SHARE = 0.5
FINEST_REACH_PX = 5.0
OUTLINE_MARGIN_PX = 2  # by which a mask may be too small


def measure_items(
    regions: Sequence[Region], scene: Reconstruction, hints: Sequence[Hint], *, pose_sd: float
) -> list[MeasuredItem] | Failure:
    """Volumes of the foods that can be measured, in the regions' order. Failure "food_not_measured" if there is none.

    pose_sd: see volume.estimate_volume.
    """
    foods = np.any([region.mask for region in regions], axis=0)
    measured = []
    for region in regions:
        elsewhere = scene.is_ignored | (foods & ~region.mask)
        form = hints[region.hint].slice_form if region.hint is not None else None
        measured.append(_measure(region, scene, elsewhere, form, pose_sd))
    return without_clutter(measured)


def _measure(
    region: Region,
    scene: Reconstruction,
    elsewhere: MaskArray,
    form: SliceForm | None,
    pose_sd: float,
) -> MeasuredItem | None:
    """Measure one food. elsewhere: (H, W) the sheet, what is not seen, and the other foods."""
    points_table, reach_px = scene.points_table, scene.disparity.reach_px
    is_measured = np.isfinite(points_table[..., 2])
    # Near the outline a window may have matched what lies behind; the larger the window, the further in.
    reach = np.where(reach_px < FINEST_REACH_PX, FINE_REACH_SHARE, 1.0) * reach_px
    depth_px = inward_px(region.mask)
    points = points_table[is_measured & (depth_px > reach)].astype(np.float64)
    support = support_height_mm(points_table, region.mask, elsewhere)
    volume = estimate_volume(
        points,
        support or 0.0,
        form,
        scene.rectified.first_centre_mm,
        outline_test(scene.rectified, region.mask),
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
