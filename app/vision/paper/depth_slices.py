"""A food's volume as the paper prints it: slices along the depth axis, a circle or an ellipse fitted to each, doubled.

Points of the side that is seen, in the depth frame (printed_stereo.py) -> volume (ml) with its 90 % interval.
What faces away is the mirror image of what is seen, about the plane across the depth axis where the seen surface ends
(section IV.E leaves the plane open; docs/volume.md, "The paper's method as printed").
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.geometry.mesh import ClosedShape
from app.vision.geometry.slices import SLICES, Slice, stack_of_slices
from app.vision.model import EstimateOptions, Float64Array, Hint, SliceForm
from app.vision.paper.cut_slices import CELLS_ACROSS, CLOSING_CELLS, filled
from app.vision.paper.measure_items import HIDDEN_SD, MIN_POINTS, MIN_SLICES
from app.vision.paper.printed_stereo import PrintedStereo, reconstruct_as_printed
from app.vision.paper.symmetry import SymmetryAxis
from app.vision.scene.segmentation import Region
from app.vision.solids.measured_item import (
    NORMAL_90,
    SCALE_SD,
    MeasuredItem,
    Volume,
    is_low_texture,
    without_clutter,
)
from app.vision.solids.sections import cut_sections
from app.vision.views.features import Matches
from app.vision.views.rectification import RectifiedPair
from app.vision.views.relative_pose import RefinedViews

STRAY_SHARE = 0.001  # of a food's points at either end of its depth: half an ellipsoid loses 5 % of its depth by it
MIN_BOUNDARY = 5  # points, of which an ellipse has as many unknowns
HIDDEN_SHARE = 0.5  # of the volume: the mirror image
# half a turn about the baseline: z from the depth axis to the camera
TOWARDS_CAMERA = np.array([1.0, -1.0, -1.0])


def measure_as_printed(
    regions: Sequence[Region],
    views: RefinedViews,
    matches: Matches | None,
    pair: RectifiedPair,
    options: EstimateOptions,
) -> tuple[list[MeasuredItem] | Failure, PrintedStereo | None]:
    """Volumes by the founding paper to the letter, in the regions' order, and the stereo that they come from.

    Of what stands above, the foods' masks alone take part. Failures: "food_not_measured" if no food can be measured,
    and those of the stereo, which is None then.
    """
    if matches is None or views.first.marker is None:
        raise ValueError(
            "The method paper-strict takes its tie points from a marker, not from a rig."
        )
    masks, rng = [region.mask for region in regions], np.random.default_rng(options.seed)
    stereo = reconstruct_as_printed(views, matches, pair, masks, rng)
    if isinstance(stereo, Failure):
        return stereo, None
    return _measure_surfaces(regions, stereo, options.hints), stereo


def _measure_surfaces(
    regions: Sequence[Region], stereo: PrintedStereo, hints: Sequence[Hint]
) -> list[MeasuredItem] | Failure:
    measured: list[MeasuredItem | None] = []
    for region, mask, surface in zip(regions, stereo.masks, stereo.surfaces, strict=True):
        points = stereo.points_mm[surface].astype(np.float64)
        form = hints[region.hint].slice_form if region.hint is not None else None
        slices, middle_mm = cut_depth_slices(points, form or "ellipse")
        if len(slices) < MIN_SLICES:
            measured.append(None)
            continue
        depth_sd = _depth_sd(stereo, float(np.median(stereo.disparity_px[surface])))
        points_table = stereo.to_table(points)
        volume, support_mm = _volume(
            slices, middle_mm, form or "ellipse", stereo, points_table, depth_sd
        )
        flags = ("low_texture",) if is_low_texture(surface, mask) else ()
        measured.append(MeasuredItem(region, points_table, support_mm, volume, flags))
    return without_clutter(measured)


def cut_depth_slices(points_mm: Float64Array, form: SliceForm) -> tuple[list[Slice], float]:
    """Slices of what is seen, and the depth of the plane of symmetry, mm; their heights count from it to the camera.

    points_mm: (n, 3), depth frame. Empty list for fewer than MIN_POINTS or no depth at all.
    """
    if len(points_mm) < MIN_POINTS:
        return [], 0.0
    near, far = np.quantile(points_mm[:, 2], [STRAY_SHARE, 1 - STRAY_SHARE])
    if far <= near:
        return [], float(far)
    thickness = float(far - near) / SLICES
    turned = points_mm * TOWARDS_CAMERA + [0.0, 0.0, far]
    number = np.floor(turned[:, 2] / thickness).astype(np.int64)
    extent = np.ptp(np.quantile(turned[:, :2], [STRAY_SHARE, 1 - STRAY_SHARE], axis=0), axis=0)
    cell = max(float(extent.max()) / CELLS_ACROSS, 0.05)
    slices = []
    for index in range(SLICES):
        # A slice's ring has its hole where nearer slices have their points: with these, a ring that noise has broken
        # is filled as well.
        fitted = _fit_slice(
            turned[number >= index, :2], (index * thickness, (index + 1) * thickness), cell, form
        )
        if fitted is not None:
            slices.append(fitted)
    return slices, float(far)


def _fit_slice(
    xy: Float64Array, place: tuple[float, float], cell_mm: float, form: SliceForm
) -> Slice | None:
    """Binary data, closed and filled; the form is fitted to the boundary of its largest part (section IV.F)."""
    if len(xy) < MIN_BOUNDARY:
        return None
    low = xy.min(axis=0)
    pad = CLOSING_CELLS + 1
    cells = np.floor((xy - low) / cell_mm).astype(np.int64) + pad
    picture = np.zeros(
        (int(cells[:, 1].max()) + pad + 1, int(cells[:, 0].max()) + pad + 1), np.uint8
    )
    picture[cells[:, 1], cells[:, 0]] = 1
    kernel = cv2.getStructuringElement(
        cv2.MORPH_ELLIPSE, (2 * CLOSING_CELLS + 1, 2 * CLOSING_CELLS + 1)
    )
    closed = filled(np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, kernel), np.uint8))
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    boundary = max(contours, key=cv2.contourArea).reshape(-1, 2).astype(np.float64)
    if len(boundary) < MIN_BOUNDARY or np.linalg.matrix_rank(boundary - boundary.mean(axis=0)) < 2:
        return None
    if form == "ellipse":
        (x, y), diameters, turn_deg = cv2.fitEllipse(boundary.astype(np.float32))
        across, along = sorted(diameters)
        heading = float(np.radians(turn_deg)) + (0.0 if diameters[0] >= diameters[1] else np.pi / 2)
        middle, half_cells = np.array([x, y]), (along / 2, across / 2)
    else:
        middle, radius = _fit_circle(boundary)
        half_cells, heading = (radius, radius), 0.0
    # A contour runs through the centres of the boundary's cells: half a cell of the region lies outside it.
    half_axes = ((half_cells[0] + 0.5) * cell_mm, (half_cells[1] + 0.5) * cell_mm)
    centre = low + (middle - pad + 0.5) * cell_mm
    if not np.isfinite([*half_axes, *centre]).all() or half_axes[0] > max(closed.shape) * cell_mm:
        return None  # larger than what it was fitted to: an arc too flat to tell a size
    radii = SymmetryAxis(middle, heading, half_axes[0] / half_axes[1]).scaled_radius(boundary)
    return Slice(
        *place, centre, half_axes, heading, float(np.std(radii) / np.mean(radii)), "fitted"
    )


def _fit_circle(boundary: Float64Array) -> tuple[Float64Array, float]:
    """Centre (2,) and radius by linear least squares, |x|^2 = 2 c x + (r^2 - |c|^2)."""
    middle = boundary.mean(axis=0)
    offsets = boundary - middle
    design = np.column_stack([2 * offsets, np.ones(len(offsets))])
    (a, b, rest), *_ = np.linalg.lstsq(design, (offsets**2).sum(axis=1), rcond=None)
    return middle + np.array([a, b]), float(np.sqrt(rest + a**2 + b**2))


def _mirrored(layer: Slice) -> Slice:
    return replace(layer, low_mm=-layer.high_mm, high_mm=-layer.low_mm, source="mirrored")


def _depth_sd(stereo: PrintedStereo, disparity_px: float) -> float:
    """Relative sd of a volume by that of p and q: it grows as Z^2 across the depth axis and as q along it."""
    p_mm, q_mm_px = stereo.depth.p_mm, stereo.depth.q_mm_px
    depth_mm = p_mm + q_mm_px / disparity_px
    gradient = np.array([2 / depth_mm, 2 / (depth_mm * disparity_px) + 1 / q_mm_px])
    return float(np.sqrt(gradient @ stereo.depth_covariance @ gradient))


def _volume(
    slices: Sequence[Slice],
    middle_mm: float,
    form: SliceForm,
    stereo: PrintedStereo,
    seen_table: Float64Array,
    depth_sd: float,
) -> tuple[Volume, float]:
    """Twice the sum of V_k (eq. 15), and the height of its lowest point, mm. seen_table: (n, 3) the food's points.

    The paper gives no interval: this one is of the causes that are known here. The volume's own slices, which pictures
    show, are horizontal sections of the shape, as of any other method.
    """
    shape = stack_of_slices([*slices, *(_mirrored(layer) for layer in slices)])
    vertices = stereo.to_table((shape.vertices_mm - [0.0, 0.0, middle_mm]) * TOWARDS_CAMERA)
    support_mm = float(vertices[:, 2].min())
    volume_ml = 2 * sum(layer.volume_ml for layer in slices)
    residual = float(
        np.average(
            [layer.residual for layer in slices], weights=[layer.area_mm2 for layer in slices]
        )
    )
    pair_sd = float(np.hypot(3 * SCALE_SD, depth_sd))
    item_sd = float(np.hypot(residual, HIDDEN_SD * HIDDEN_SHARE))
    factor = float(np.exp(NORMAL_90 * np.hypot(pair_sd, item_sd)))
    return Volume(
        volume_ml=volume_ml,
        interval_ml=(volume_ml / factor, volume_ml * factor),
        relative_sd={"pair": pair_sd, "item": item_sd},
        form=form,
        centre_mm=seen_table[:, :2].mean(axis=0),
        slices=cut_sections(vertices, shape.faces, support_mm),
        completed_mm=seen_table - [0.0, 0.0, support_mm],
        shape=ClosedShape(vertices - [0.0, 0.0, support_mm], shape.faces),
    ), support_mm
