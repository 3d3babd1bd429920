"""The hidden side of a food, completed by symmetry (paper, section IV.E).

Points of the visible side, z up from the support -> the vertical axis about which half a turn maps the food onto
itself, and the points completed by that half turn. A sphere, an ellipsoid at any heading, a box, a loaf have that
symmetry; a mirror plane across the line of sight, the paper's picture, has it only for foods that lie square to it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from app.vision.model import Float64Array, SliceForm

SECTORS = 48
# of the radii in a sector: its outline, on a flat top too, less a stray point or two
OUTER_QUANTILE = 0.9
MIN_POINTS = 3  # in a sector of a slice; one or two may be strays
ELLIPSE_FROM_ASPECT = 1.15  # below, noise of the outline makes an ellipse of a circle
MAX_LOG_ASPECT = float(np.log(6.0))
OUTSIDE_WEIGHT = 3.0  # of the axis' distance from where points are against the outlines' mean misfit: nearly a wall
HALF_TURN_WEIGHT = 3.0  # of opposite radii against a radius' misfit to the common shape: this symmetry needs no ellipse
FOOTPRINT_CELLS = 96
BODY_CELLS = 48
BODY_DENSITY = 0.1  # of the median cell's points: thinner cells do not connect
HOLLOW_SHARE = 0.95  # of the radius above; less by more than noise is a hollow's inside
LOSS_SCALE = 0.05  # of the radius; points further off pull only linearly


@dataclass(frozen=True, slots=True)
class SymmetryAxis:
    """A vertical axis and the slices' common shape around it.

    centre_mm: (2,). heading: of the long half-axis, radians from x. aspect: long to short half-axis, 1 for a circle.
    """

    centre_mm: Float64Array
    heading: float
    aspect: float

    def scaled_radius(self, xy: Float64Array) -> Float64Array:
        """(n,) radius of the circle of equal area that belongs to each point's ellipse, mm."""
        u, v = self._along(xy)
        root = np.sqrt(self.aspect)
        return np.asarray(np.hypot(u / root, v * root), np.float64)

    def _along(self, xy: Float64Array) -> tuple[Float64Array, Float64Array]:
        d = xy - self.centre_mm
        cosine, sine = np.cos(self.heading), np.sin(self.heading)
        return d[:, 0] * cosine + d[:, 1] * sine, d[:, 1] * cosine - d[:, 0] * sine


def slice_index(z_mm: Float64Array, thickness_mm: float) -> NDArray[np.int64]:
    """(n,) number of the slice that each height lies in, from 0 at the support."""
    return np.floor(z_mm / thickness_mm).astype(np.int64)


def main_body(points_mm: Float64Array) -> Float64Array:
    """(m, 3) points that hang together, seen from above, with most of the others; strays dropped. points_mm: (n, 3)."""
    xy = points_mm[:, :2]
    low, high = np.quantile(xy, [0.01, 0.99], axis=0)
    cell = max(float((high - low).max()) / BODY_CELLS, 0.5)
    near = ((xy >= low - BODY_CELLS * cell) & (xy <= high + BODY_CELLS * cell)).all(axis=1)
    cells = np.floor((xy[near] - (low - BODY_CELLS * cell)) / cell).astype(np.int64)
    counts = np.zeros((3 * BODY_CELLS + 2, 3 * BODY_CELLS + 2), np.float32)
    np.add.at(counts, (cells[:, 1], cells[:, 0]), 1.0)
    enough = BODY_DENSITY * float(np.median(counts[counts > 0]))
    occupied = cv2.morphologyEx(
        (counts >= enough).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)
    )
    _, labels = cv2.connectedComponents(occupied)
    label = labels[cells[:, 1], cells[:, 0]]
    if not (label > 0).any():
        return points_mm
    largest = int(np.bincount(label[label > 0]).argmax())
    return np.asarray(points_mm[near][label == largest], np.float64)


def fit_axis(
    points_mm: Float64Array,
    thickness_mm: float,
    form: SliceForm | None,
    towards_camera: Float64Array,
) -> SymmetryAxis:
    """Centre, and for ellipses heading and aspect, that make the radii of each slice's outline most alike.

    points_mm: (n, 3), z from the support. towards_camera: (2,) unit vector on the table. Minimises the outlines' radii
    about each slice's mean, and opposite radii's differences; slices near the top, seen all around, tell the centre,
    and the lower ones follow. form None: ellipse if its aspect passes ELLIPSE_FROM_ASPECT. Raises ValueError for fewer
    than 8 points.
    """
    if len(points_mm) < 8:
        raise ValueError("An axis needs 8 points.")
    footprint = _footprint(points_mm[:, :2])
    middle = footprint.deepest_mm
    circle = _fit(
        points_mm,
        thickness_mm,
        SymmetryAxis(middle, 0.0, 1.0),
        footprint,
        towards_camera,
        is_ellipse=False,
    )
    if form == "circle":
        return circle
    variances, directions = np.linalg.eigh(np.cov(points_mm[:, :2].T))
    start = SymmetryAxis(
        middle,
        float(np.arctan2(directions[1, 1], directions[0, 1])),
        float(
            np.clip(np.sqrt(variances[1] / max(variances[0], 1e-9)), 1.05, np.exp(MAX_LOG_ASPECT))
        ),
    )
    ellipse = _fit(points_mm, thickness_mm, start, footprint, towards_camera, is_ellipse=True)
    return ellipse if form == "ellipse" or ellipse.aspect >= ELLIPSE_FROM_ASPECT else circle


def outline(
    points_mm: Float64Array,
    thickness_mm: float,
    centre_mm: Float64Array,
    towards_camera: Float64Array,
) -> NDArray[np.int64]:
    """(m,) indices of the points on each slice's outline, one a sector in which there are enough.

    On the side away from the camera no overhang can be seen: there a slice's point that lies further in than the
    outline above it is the inside of a hollow, such as an apple's, and no outline.
    """
    slices = slice_index(points_mm[:, 2], thickness_mm)
    d = points_mm[:, :2] - centre_mm
    sector = sector_index(d)
    key = slices * SECTORS + sector
    radius = np.hypot(d[:, 0], d[:, 1])
    order = np.lexsort((radius, key))
    sorted_key = key[order]
    starts = np.flatnonzero(np.r_[True, sorted_key[1:] != sorted_key[:-1]])
    counts = np.diff(np.r_[starts, len(order)])
    enough = counts >= MIN_POINTS
    picks = order[starts[enough] + np.floor(OUTER_QUANTILE * (counts[enough] - 1)).astype(np.int64)]
    away = d[picks] @ towards_camera < 0
    above = np.zeros(SECTORS)  # the outline's greatest radius above, sector by sector
    is_outline = np.ones(len(picks), np.bool_)
    for place in np.argsort(-key[picks], kind="stable"):
        outer_mm = radius[picks[place]]
        is_outline[place] = (
            not away[place] or outer_mm >= HOLLOW_SHARE * above[sector[picks[place]]]
        )
        above[sector[picks[place]]] = max(above[sector[picks[place]]], outer_mm)
    return np.asarray(picks[is_outline], np.int64)


def sector_index(offsets_mm: Float64Array) -> NDArray[np.int64]:
    """(n,) sector, 0 to SECTORS - 1, of (n, 2) offsets from the axis."""
    angle = np.arctan2(offsets_mm[:, 1], offsets_mm[:, 0])
    return np.asarray(np.floor((angle + np.pi) / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS)


def complete(points_mm: Float64Array, thickness_mm: float, axis: SymmetryAxis) -> Float64Array:
    """The points and, in those sectors of a slice that show none, those of the opposite side, turned by half a turn.

    points_mm: (n, 3) -> (m, 3), m >= n.
    """
    slices = slice_index(points_mm[:, 2], thickness_mm)
    turned = points_mm * [-1.0, -1.0, 1.0] + [*(2 * axis.centre_mm), 0.0]
    key = slices * SECTORS + sector_index(points_mm[:, :2] - axis.centre_mm)
    turned_key = slices * SECTORS + sector_index(turned[:, :2] - axis.centre_mm)
    return np.concatenate([points_mm, turned[~np.isin(turned_key, key)]])


@dataclass(frozen=True, slots=True)
class _Footprint:
    """Where points were seen, from above.

    depth_mm: (h, w) distance to its border, negative outside. low_mm: (2,) its origin.
    """

    depth_mm: NDArray[np.float32]
    low_mm: Float64Array
    cell_mm: float
    deepest_mm: Float64Array

    def depth_at(self, xy: Float64Array) -> float:
        """Depth at (2,) mm, bilinear, falling by a mm a mm beyond the picture."""
        place = (xy - self.low_mm) / self.cell_mm
        limit = np.array(self.depth_mm.shape[::-1]) - 1.001
        inside = np.clip(place, 0.0, limit)
        column, row = np.floor(inside).astype(np.int64)
        u, v = inside - [column, row]
        corner = self.depth_mm[row : row + 2, column : column + 2]
        value = (corner[0, 0] * (1 - u) + corner[0, 1] * u) * (1 - v) + (
            corner[1, 0] * (1 - u) + corner[1, 1] * u
        ) * v
        return float(value - np.hypot(*(place - inside)) * self.cell_mm)


def _footprint(xy_mm: Float64Array) -> _Footprint:
    """The points seen from above, their gaps closed."""
    low, high = np.quantile(xy_mm, [0.005, 0.995], axis=0)
    inside = xy_mm[((xy_mm >= low) & (xy_mm <= high)).all(axis=1)]
    cell = max(float((high - low).max()) / FOOTPRINT_CELLS, 0.25)
    pad = 6
    shape = np.ceil((high - low) / cell).astype(np.int64) + 1 + 2 * pad
    picture = np.zeros((int(shape[1]), int(shape[0])), np.uint8)
    cells = np.rint((inside - low) / cell).astype(np.int64) + pad
    picture[cells[:, 1], cells[:, 0]] = 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    closed = cv2.morphologyEx(picture, cv2.MORPH_CLOSE, kernel)
    depth = (
        cv2.distanceTransform(closed, cv2.DIST_L2, 5)
        - cv2.distanceTransform(1 - closed, cv2.DIST_L2, 5)
    ) * cell
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    origin = low - pad * cell
    return _Footprint(
        depth.astype(np.float32), origin, cell, origin + np.array([column, row]) * cell
    )


def _fit(
    points_mm: Float64Array,
    thickness_mm: float,
    start: SymmetryAxis,
    footprint: _Footprint,
    towards_camera: Float64Array,
    *,
    is_ellipse: bool,
) -> SymmetryAxis:
    """Three rounds, since which points are the outline depends on the centre."""
    axis = start
    for _ in range(3):
        chosen = points_mm[outline(points_mm, thickness_mm, axis.centre_mm, towards_camera)]
        if len(chosen) < 6:
            return axis
        slices = np.unique(slice_index(chosen[:, 2], thickness_mm), return_inverse=True)[1]
        axis = _fit_outline(chosen, slices, axis, footprint, is_ellipse)
    return axis


def _opposite(
    chosen: Float64Array, slices: NDArray[np.int64], centre_mm: Float64Array
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(k,), (k,) indices of outline points that half a turn about the centre maps onto each other."""
    key = slices * SECTORS + sector_index(chosen[:, :2] - centre_mm)
    turned = slices * SECTORS + sector_index(centre_mm - chosen[:, :2])
    _, index, opposite = np.intersect1d(key, turned, return_indices=True)
    return index, opposite


def _fit_outline(
    chosen: Float64Array,
    slices: NDArray[np.int64],
    start: SymmetryAxis,
    footprint: _Footprint,
    is_ellipse: bool,
) -> SymmetryAxis:
    counts = np.bincount(slices)
    size = float(np.median(start.scaled_radius(chosen[:, :2])))
    index, opposite = _opposite(chosen, slices, start.centre_mm)
    weight = (counts / SECTORS)[slices]  # a short arc tells little of where its centre is

    def read(unknowns: Float64Array) -> SymmetryAxis:
        centre = start.centre_mm + unknowns[:2] * size
        if not is_ellipse:
            return SymmetryAxis(centre, 0.0, 1.0)
        log_aspect = float(min(np.hypot(*unknowns[2:]), MAX_LOG_ASPECT))
        return SymmetryAxis(
            centre, 0.5 * float(np.arctan2(unknowns[3], unknowns[2])), float(np.exp(log_aspect))
        )

    def residual(unknowns: Float64Array) -> Float64Array:
        # Not relative to each slice's own radius: that would draw the centre away, where all radii are alike.
        axis = read(unknowns)
        radius = axis.scaled_radius(chosen[:, :2]) / size
        mean = np.bincount(slices, radius) / counts
        # Over its axis a food's top is seen: the axis must stand where points are.
        outside = max(0.0, -footprint.depth_at(axis.centre_mm)) / size
        return np.concatenate(
            [
                weight * (radius - mean[slices]),
                HALF_TURN_WEIGHT * (radius[index] - radius[opposite]),
                [OUTSIDE_WEIGHT * len(chosen) * outside],
            ]
        )

    first = np.zeros(2)
    if is_ellipse:  # aspect and heading as a vector of twice the angle: smooth through the circle
        log_aspect = max(float(np.log(start.aspect)), 0.05)
        first = np.concatenate(
            [first, log_aspect * np.array([np.cos(2 * start.heading), np.sin(2 * start.heading)])]
        )
    return read(scipy.optimize.least_squares(residual, first, loss="soft_l1", f_scale=LOSS_SCALE).x)
