"""A food's points as a stack of slices, a circle or an ellipse fitted to each (paper, section IV.F).

Completed points, z up from the support -> slices with outline and area, bottom to top. Their sum is measure_items.py's.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from app.vision.geometry.slices import Slice, Source
from app.vision.model import Float64Array, ImageArray, MaskArray, SliceForm
from app.vision.paper.symmetry import SECTORS, SymmetryAxis, outline, slice_index

CELLS_ACROSS = 96  # of a slice's binary picture
CLOSING_CELLS = 3  # gaps of the outline that morphology closes
# of the sectors with points, for a slice's own form; else the common shape is scaled
MIN_FREE_SHARE = 0.6
MIN_SHARE = 0.12  # of the sectors; below, a slice counts as not seen
PAD_CELLS = 2
WIDEST_SHARE = 0.95  # of the greatest area: the slices whose mean height is the mirror's, steadier than the greatest
CARVE_CELLS = 32  # across a slice
SUBCELL_BITS = 4  # fractional bits of the outline's corners


def cut_slices(
    points_mm: Float64Array,
    thickness_mm: float,
    axis: SymmetryAxis,
    form: SliceForm,
    towards_camera: Float64Array,
) -> list[Slice]:
    """Slices from the support to the top; those that show too little take their form from the others.

    points_mm: (n, 3) completed (symmetry.complete), z from the support. Empty list if no slice can be fitted.
    """
    chosen = outline(points_mm, thickness_mm, axis.centre_mm, towards_camera)
    index = slice_index(points_mm[chosen, 2], thickness_mm)
    top = int(slice_index(points_mm[:, 2], thickness_mm).max(initial=-1))
    fitted: dict[int, Slice] = {}
    for number in range(top + 1):
        ring = points_mm[chosen[index == number], :2]
        share = len(ring) / SECTORS
        if share < MIN_SHARE:
            continue
        place = (number * thickness_mm, (number + 1) * thickness_mm)
        fitted[number] = (
            _fit_form(ring, place, axis, form)
            if share >= MIN_FREE_SHARE
            else _scale(ring, place, axis)
        )
    if not fitted:
        return []
    return [
        fitted.get(number) or _unseen(number, thickness_mm, fitted)
        for number in range(max(fitted) + 1)
    ]


def section_of(ring_mm: Float64Array, axis: SymmetryAxis) -> tuple[ImageArray, Float64Array, float]:
    """A slice as binary data: outline joined up, closed, holes filled (section IV.F).

    ring_mm: (n, 2) outline, one point a sector. Returns the picture, its origin (2,) mm and its cell, mm. Between known
    sectors the outline runs as the food's common shape does.
    """
    offsets = ring_mm - axis.centre_mm
    angles = np.arctan2(offsets[:, 1], offsets[:, 0])
    order = np.argsort(angles)
    every = (np.arange(SECTORS * 4) + 0.5) / (SECTORS * 4) * 2 * np.pi - np.pi
    scaled = np.interp(every, angles[order], axis.scaled_radius(ring_mm)[order], period=2 * np.pi)
    directions = np.column_stack([np.cos(every), np.sin(every)])
    polygon = (
        axis.centre_mm
        + directions * (scaled / axis.scaled_radius(axis.centre_mm + directions))[:, None]
    )
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    cell = max(float((high - low).max()) / CELLS_ACROSS, 0.05)
    pad = PAD_CELLS + CLOSING_CELLS
    shape = np.ceil((high - low) / cell).astype(np.int64) + 1 + 2 * pad
    picture = np.zeros((int(shape[1]), int(shape[0])), np.uint8)
    corners = np.rint(((polygon - low) / cell + pad) * 2**SUBCELL_BITS).astype(np.int32)
    cv2.polylines(picture, [corners], True, 1, shift=SUBCELL_BITS)
    kernel = cv2.getStructuringElement(
        cv2.MORPH_ELLIPSE, (2 * CLOSING_CELLS + 1, 2 * CLOSING_CELLS + 1)
    )
    closed = np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, kernel), np.uint8)
    return filled(closed), low - pad * cell, cell


def carve(
    slices: Sequence[Slice], is_in_outline: Callable[[Float64Array], MaskArray]
) -> list[Slice]:
    """Slices without what would be seen beside the food if it were there.

    is_in_outline: (n, 3) points over the support, mm -> (n,) whether they project into the food's mask. Completion by
    symmetry may reach out of the outline; its form is then refitted to what lies inside, in area and centre.
    """
    unit = np.stack(
        np.meshgrid(*[(np.arange(CARVE_CELLS) + 0.5) / CARVE_CELLS * 2 - 1] * 2), -1
    ).reshape(-1, 2)
    unit = unit[np.hypot(*unit.T) < 1]
    cells = []
    for layer in slices:
        cosine, sine = np.cos(layer.heading), np.sin(layer.heading)
        turn = np.array([[cosine, sine], [-sine, cosine]])
        xy = (unit * layer.half_axes_mm) @ turn + layer.centre_mm
        cells.append(np.column_stack([xy, np.full(len(xy), (layer.low_mm + layer.high_mm) / 2)]))
    inside = is_in_outline(np.concatenate(cells)).reshape(len(slices), -1)
    carved = []
    for layer, is_inside, points in zip(slices, inside, cells, strict=True):
        share = float(is_inside.mean())
        if share == 1.0:
            carved.append(layer)
        elif share > 0.0:
            root = float(np.sqrt(share))
            half_axes = (layer.half_axes_mm[0] * root, layer.half_axes_mm[1] * root)
            carved.append(
                replace(layer, half_axes_mm=half_axes, centre_mm=points[is_inside, :2].mean(axis=0))
            )
    return carved


def filled(picture: ImageArray) -> ImageArray:
    """Return a binary picture with its holes filled: what cannot be reached from the corner is inside."""
    flooded = picture.copy()
    cv2.floodFill(flooded, None, (0, 0), 2)
    return np.asarray(flooded != 2, np.uint8)


def _fit_form(
    ring: Float64Array, place: tuple[float, float], axis: SymmetryAxis, form: SliceForm
) -> Slice:
    """The circle or ellipse of the section's area; an ellipse with the section's centre and second moments' axes.

    Radius, or major and minor axis, from a filled region's area and moments, as image libraries define them: unlike a
    fit to boundary points it keeps the area of sections that are neither, such as a box's or a banana's.
    """
    picture, origin, cell = section_of(ring, axis)
    contours, _ = cv2.findContours(picture, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contour = max(contours, key=cv2.contourArea)
    # The contour runs through the centres of border cells, on which the outline was drawn: it is the outline.
    moments = cv2.moments(contour)
    area = moments["m00"] * cell**2
    if area <= 0:
        return _scale(ring, place, axis)
    centre = origin + cell * np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    aspect, heading = 1.0, 0.0
    if form == "ellipse":
        covariance = np.array(
            [[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]
        )
        variances, directions = np.linalg.eigh(covariance)
        aspect = float(np.sqrt(variances[1] / max(variances[0], 1e-12)))
        heading = float(np.arctan2(directions[1, 1], directions[0, 1]))
    radius = float(np.sqrt(area / np.pi))
    half_axes = (radius * float(np.sqrt(aspect)), radius / float(np.sqrt(aspect)))
    radii = SymmetryAxis(centre, heading, aspect).scaled_radius(ring)
    return Slice(
        *place, centre, half_axes, heading, float(np.std(radii) / np.mean(radii)), "fitted"
    )


def _scale(ring: Float64Array, place: tuple[float, float], axis: SymmetryAxis) -> Slice:
    """The food's common shape in the size that fits a short piece of outline."""
    radii = axis.scaled_radius(ring)
    radius, root = float(np.median(radii)), float(np.sqrt(axis.aspect))
    half_axes = (radius * root, radius / root)
    residual = float(np.std(radii) / radius)
    return Slice(*place, axis.centre_mm, half_axes, axis.heading, residual, "scaled")


def _unseen(number: int, thickness_mm: float, fitted: dict[int, Slice]) -> Slice:
    """A slice in the shadow of the food's own belly or in a gap.

    Below the lowest slice seen: the mirror image, about the height where the food is widest, of a slice above, as
    symmetry has it for fruit; drawn out downwards where the lower part is the longer one, since a food ends at its
    support. Where nothing seen is wider than the lowest slice, that one is continued down. In a gap: the nearest slice.
    """
    lowest, top = min(fitted), max(fitted)
    source: Source = "continued"
    chosen = min(fitted, key=lambda k: (abs(k - number), k))
    greatest = max(layer.area_mm2 for layer in fitted.values())
    widest = (
        float(np.mean([k for k in fitted if fitted[k].area_mm2 >= WIDEST_SHARE * greatest])) + 0.5
    )
    if number < lowest < widest - 1:
        opposite = widest + (widest - number - 0.5) * min(1.0, (top + 1 - widest) / widest) - 0.5
        chosen, source = min(fitted, key=lambda k: (abs(k - opposite), k)), "mirrored"
    low_mm, high_mm = number * thickness_mm, (number + 1) * thickness_mm
    return replace(fitted[chosen], low_mm=low_mm, high_mm=high_mm, source=source)
