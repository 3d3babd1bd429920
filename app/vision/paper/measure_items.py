"""From a food's mask to its volume by the paper: points that are surely its own, its support, its outline as a limit.

Regions of the rectified grid and its points -> measured items. V = sum of V_k over a food's slices (paper, eq. 15).
"""

from collections.abc import Callable, Sequence

import numpy as np

from app.core.errors import Failure
from app.core.units import ml_from_mm3
from app.vision.geometry.masks import dilated, inward_px
from app.vision.geometry.slices import Slice, slice_thickness_mm, stack_of_slices
from app.vision.model import Float64Array, Hint, MaskArray, SliceForm
from app.vision.paper.cut_slices import carve, cut_slices
from app.vision.paper.symmetry import complete, fit_axis, main_body
from app.vision.scene.segmentation import Region
from app.vision.scene.support import support_height_mm
from app.vision.solids.measured_item import (
    NORMAL_90,
    SCALE_SD,
    MeasuredItem,
    Volume,
    is_low_texture,
    without_clutter,
)
from app.vision.views.reconstruction import Reconstruction
from app.vision.views.rectification import RectifiedPair

# of half a fine window: it follows the surface, and shows the outline's points best
FINE_REACH_SHARE = 0.5
FINEST_REACH_PX = 5.0
OUTLINE_MARGIN_PX = 2  # by which a mask may be too small
# the paper's mean error over six fruit (Table I); times sqrt(pi / 2) a mean error is an sd
METHOD_SD = 0.077 * 1.2533
HIDDEN_SD = 0.15  # of the volume that no view shows, relative
SUPPORT_SD_MM = 1.5  # height of the support under a food
MIN_POINTS = 60
MIN_SLICES = 3
TOP_QUANTILE = 0.999  # of heights; higher points are strays


def measure_items(
    regions: Sequence[Region], scene: Reconstruction, hints: Sequence[Hint], *, pose_sd: float
) -> list[MeasuredItem] | Failure:
    """Volumes of the foods that can be measured, in the regions' order. Failure "food_not_measured" if there is none.

    pose_sd: see estimate_volume.
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


def estimate_volume(
    points_table: Float64Array,
    support_mm: float,
    form: SliceForm | None,
    camera_mm: Float64Array,
    is_in_outline: Callable[[Float64Array], MaskArray] | None = None,
    *,
    pose_sd: float = 0.0,
) -> Volume | None:
    """Volume over the support by symmetric completion and slices. points_table: (n, 3) mm, z up; None if too few.

    camera_mm: (3,) first camera's centre. is_in_outline: (n, 3) mm, table frame -> (n,) whether the points project into
    the food's mask; None: not known. pose_sd: relative, see pose_doubt.py. The interval is 90 %,
    log-normal: sd by part, "pair" (the print's scale, cubed; the poses) and "item": the slices' residuals, the hidden
    share, the support's height over the food's, and the method's own error, which is taken from the paper's Table I.
    """
    points = points_table - [0.0, 0.0, support_mm]
    points = points[points[:, 2] > 0]
    if len(points) < MIN_POINTS:
        return None
    points = main_body(points)
    top = float(np.quantile(points[:, 2], TOP_QUANTILE))
    points = points[points[:, 2] <= top]
    thickness = slice_thickness_mm(top)
    towards_camera = camera_mm[:2] - np.median(points[:, :2], axis=0)
    towards_camera /= max(float(np.linalg.norm(towards_camera)), 1e-9)
    axis = fit_axis(points, thickness, form, towards_camera)
    chosen: SliceForm = form or ("ellipse" if axis.aspect > 1.0 else "circle")
    completed = complete(points, thickness, axis)
    slices = cut_slices(completed, thickness, axis, chosen, towards_camera)
    if is_in_outline is not None and slices:
        slices = carve(
            slices, lambda above: is_in_outline(above + np.array([0.0, 0.0, support_mm]))
        )
    if len(slices) < MIN_SLICES:
        return None
    volume_ml = sum(layer.volume_ml for layer in slices)
    relative_sd = {
        "pair": float(np.hypot(3 * SCALE_SD, pose_sd)),
        "item": _item_sd(slices, volume_ml),
    }
    spread = float(np.exp(NORMAL_90 * np.hypot(relative_sd["pair"], relative_sd["item"])))
    return Volume(
        volume_ml=volume_ml,
        interval_ml=(volume_ml / spread, volume_ml * spread),
        relative_sd=relative_sd,
        form=chosen,
        centre_mm=axis.centre_mm,
        slices=tuple(slices),
        completed_mm=completed,
        shape=stack_of_slices(slices),
    )


def _item_sd(slices: list[Slice], volume_ml: float) -> float:
    hidden_ml = sum(
        layer.volume_ml for layer in slices if layer.source in ("mirrored", "continued")
    )
    # A radius' relative error counts twice in an area. Half of it is the form's misfit, whose area is kept.
    residual = float(
        np.average(
            [layer.residual for layer in slices], weights=[layer.area_mm2 for layer in slices]
        )
    )
    foot_ml = ml_from_mm3(slices[0].area_mm2 * SUPPORT_SD_MM)
    return float(
        np.sqrt(
            METHOD_SD**2
            + residual**2
            + (HIDDEN_SD * hidden_ml / volume_ml) ** 2
            + (foot_ml / volume_ml) ** 2
        )
    )


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
