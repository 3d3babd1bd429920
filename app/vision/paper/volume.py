"""Volume of one food: V = sum of V_k over its slices (paper, eq. 15), and the doubt about it.

Points of the visible side in the table frame and the support's height -> ml with a 90 % interval.
"""

from collections.abc import Callable

import numpy as np

from app.core.units import ml_from_mm3
from app.vision.geometry.slices import Slice, slice_thickness_mm, stack_of_slices
from app.vision.model import Float64Array, MaskArray, SliceForm
from app.vision.paper.slices import carve, cut_slices
from app.vision.paper.symmetry import complete, fit_axis, main_body
from app.vision.solids.measured_item import NORMAL_90, SCALE_SD, Volume

METHOD_SD = (
    0.077 * 1.2533
)  # the paper's mean error over six fruit (Table I); times sqrt(pi / 2) a mean error is an sd
HIDDEN_SD = 0.15  # of the volume that no view shows, relative
SUPPORT_SD_MM = 1.5  # height of the support under a food
MIN_POINTS = 60
MIN_SLICES = 3
TOP_QUANTILE = 0.999  # of heights; higher points are strays


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
