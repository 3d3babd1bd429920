"""Outlines to a fraction of a pixel: from a mask or a form's own outline to where the colours part.

A ring of points with outward normals and an image -> where inside and outside part along each normal, and how clearly.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.masks import window_around
from app.vision.geometry.mesh import IntArray
from app.vision.geometry.pictures import sampled
from app.vision.model import Float32Array, Float64Array, MaskArray

STEP_PX = 2.0  # between points of a ring
SUPERSAMPLING = 4  # of a mask, to find its outline between the pixels
MIN_RING_PX = 12.0
SAMPLE_PX = 0.5  # along a normal
BAND_PX = (3.5, 9.0)  # from the ring, where colours are surely inside or outside
NEAR_BAND_PX = (2.5, 7.0)  # the same beside an outline that is exact
ALONG = 5  # points over which profiles are averaged
ALONG_BAND = 9  # points over which the bands' colours are averaged
MAX_COST = 4.0  # of one sample: a speck or a highlight is no boundary
LAB_NOISE = 4.0  # squared distance in Lab that is none
# squared colour difference over the bands' variances from which a boundary is certain
CLEAR_CONTRAST = 4.0
MIN_CLEAR = 0.15
ROUNDS = 2
STEEP_SAMPLE_PX = 0.25  # along a normal
STEEP_SD_PX = 0.5  # over which the change of colour is taken
STEEP_REACH_PX = 1.5  # around where the colours part
_STEEP_AT = np.arange(-8, 9) / (STEEP_SD_PX / STEEP_SAMPLE_PX)
STEEP_KERNEL = _STEEP_AT * np.exp(-0.5 * _STEEP_AT**2)  # a Gaussian's derivative, but for a factor
KDTREE_SINGLE, LEAF_POINTS = 4, 10  # of cv::flann::KDTreeSingleIndexParams

Reference = Callable[[Float64Array], tuple[Float64Array, Float64Array]]


class Nearest:
    """Finds the nearest of (n, 2) points, px; n > 0. In single precision: distances are right to 1e-3 px.

    By OpenCV's exact single k-d tree, which is built in microseconds (decision 0051).
    """

    def __init__(self, points_px: Float64Array) -> None:
        self._origin_px = points_px[0].copy()
        self._points_px = self._relative(points_px)  # the tree may look at them
        params: dict[str, bool | int | float | str] = {
            "algorithm": KDTREE_SINGLE,
            "leaf_max_size": LEAF_POINTS,
        }
        self._index = cv2.flann.Index(self._points_px, params)

    def query(self, points_px: Float64Array) -> tuple[Float64Array, IntArray]:
        """Return how far (m, 2) points are from the nearest, (m,) px, and which that is, (m,)."""
        index, squared = self._index.knnSearch(self._relative(points_px), 1, params={})
        return np.sqrt(squared[:, 0], dtype=np.float64), index[:, 0].astype(np.int64)

    def _relative(self, points_px: Float64Array) -> Float32Array:
        return np.asarray(points_px - self._origin_px, np.float32)


@dataclass(frozen=True, slots=True)
class Outline:
    """points_px, normals: (n, 2), outward. weights: (n,) how surely each is on the food's outline, 0 to 1."""

    points_px: Float64Array
    normals: Float64Array
    weights: Float64Array
    nearest: Nearest


@dataclass(frozen=True, slots=True)
class Ring:
    """A closed line of points, px, with outward normals, both (n, 2)."""

    points_px: Float64Array
    normals: Float64Array


def outline(rings: Sequence[Ring], weights: Float64Array) -> Outline:
    """All rings as one."""
    points = np.concatenate([ring.points_px for ring in rings])
    return Outline(
        points, np.concatenate([ring.normals for ring in rings]), weights, Nearest(points)
    )


def rings_of_mask(mask: MaskArray) -> list[Ring]:
    """The outlines of a mask, holes included, evenly spaced and smoothed over a pixel."""
    if not mask.any():
        return []
    rows, columns = window_around(mask, 3)
    low = np.array([rows.start, columns.start])
    soft = mask[rows, columns].astype(np.float32)
    fine = cv2.resize(
        soft, None, fx=SUPERSAMPLING, fy=SUPERSAMPLING, interpolation=cv2.INTER_LINEAR
    )
    contours, _ = cv2.findContours(
        (fine > 0.5).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
    )
    rings = []
    for contour in contours:
        line = (np.asarray(contour, np.float64).reshape(-1, 2) + 0.5) / SUPERSAMPLING - 0.5
        if len(line) < MIN_RING_PX * SUPERSAMPLING:
            continue
        points = _evenly(_smoothed(line, 3 * SUPERSAMPLING + 1))
        normals = _normals(points)
        inside = (
            _sample(soft, points - 3 * normals).mean() - _sample(soft, points + 3 * normals).mean()
        )
        rings.append(Ring(points + low[::-1], normals if inside > 0 else -normals))
    return rings


def snap(
    lab: Float32Array, rings: Sequence[Ring], reach_px: float, reference: Reference | None = None
) -> Outline:
    """Each ring moved along its normals, by reach_px at most a round, to where the colours part best.

    A glossy limb takes on its surroundings' colour before it ends, so that half way between both colours lies within
    it; the steepest change near there is its edge.

    lab: (H, W, 3). reference: points (n, 2) -> colours (n, 3) known to lie inside and outside there, from elsewhere.
    """
    moved, weights = [], []
    for ring in rings:
        points, clear = ring.points_px, np.zeros(len(ring.points_px))
        for _ in range(ROUNDS):
            offset, clear = _parting(
                lab, points, ring.normals, reach_px, reference(points) if reference else None
            )
            offset = _median(np.where(clear > MIN_CLEAR, offset, 0.0))
            points = points + offset[:, None] * ring.normals
        offset = _median(np.where(clear > MIN_CLEAR, _steepest(lab, points, ring.normals), 0.0))
        points = points + offset[:, None] * ring.normals
        normals = _normals(points)
        turned = np.sign((normals * ring.normals).sum(axis=1, keepdims=True))
        moved.append(Ring(points, normals * turned))
        weights.append(clear)
    return outline(moved, np.concatenate(weights))


def colours_beside(lab: Float32Array, line: Outline) -> tuple[Float64Array, Float64Array]:
    """(n, 3), (n, 3) mean colour just inside and just outside an outline."""
    inside, outside = (
        _profiles(lab, line.points_px, line.normals, side * np.arange(*NEAR_BAND_PX, 0.75)).mean(
            axis=1
        )
        for side in (-1, 1)
    )
    return inside, outside


def _parting(
    lab: Float32Array,
    points: Float64Array,
    normals: Float64Array,
    reach_px: float,
    reference: tuple[Float64Array, Float64Array] | None,
) -> tuple[Float64Array, Float64Array]:
    """(n,) offset along each normal that splits its profile best, and (n,) how clearly the two sides differ.

    Between the colours of both bands a profile runs from 1 inside to 0 outside; the split with least squares is
    refined to where it crosses one half.
    """
    along = np.arange(-BAND_PX[1], BAND_PX[1] + SAMPLE_PX / 2, SAMPLE_PX)
    raw = _profiles(lab, points, normals, along)
    profiles = _around(raw, ALONG)
    is_inside, is_outside = along <= -BAND_PX[0], along >= BAND_PX[0]
    inside, outside = (
        _around(raw[:, band].mean(axis=1), ALONG_BAND) for band in (is_inside, is_outside)
    )
    spread = sum(
        _around(raw[:, band].var(axis=1).sum(axis=-1), ALONG_BAND)
        for band in (is_inside, is_outside)
    )
    if reference is not None:
        inside, outside = _reconciled(inside, outside, reference)
    difference = inside - outside
    contrast = (difference**2).sum(axis=1)
    level = ((profiles - outside[:, None]) * difference[:, None]).sum(axis=2) / np.maximum(
        contrast, 1e-6
    )[:, None]
    misfit_inside = np.cumsum(np.clip((level - 1) ** 2, 0, MAX_COST), axis=1)
    misfit_outside = np.cumsum(np.clip(level**2, 0, MAX_COST)[:, ::-1], axis=1)[:, ::-1]
    middle = (along[:-1] + along[1:]) / 2
    cost = np.where(
        np.abs(middle) <= reach_px, misfit_inside[:, :-1] + misfit_outside[:, 1:], np.inf
    )
    best, each = cost.argmin(axis=1), np.arange(len(points))
    here, there = level[each, best], level[each, best + 1]
    falls = here - there > 1e-3
    share = np.where(falls, (here - 0.5) / np.where(falls, here - there, 1.0), 0.5)
    share = np.where((share > -1) & (share < 2), share, 0.5)
    offset = along[best] + np.clip(share, -0.5, 1.5) * SAMPLE_PX
    clear = np.clip(contrast / (spread + LAB_NOISE) / CLEAR_CONTRAST, 0, 1)
    return offset, clear * (np.abs(offset) < reach_px - 0.3)


def _steepest(lab: Float32Array, points: Float64Array, normals: Float64Array) -> Float64Array:
    """(n,) offset along each normal, within STEEP_REACH_PX, where colour changes most."""
    most = STEEP_REACH_PX + 6 * STEEP_SD_PX
    along = np.arange(-most, most + STEEP_SAMPLE_PX / 2, STEEP_SAMPLE_PX)
    profiles = _around(_profiles(lab, points, normals, along), ALONG)
    slope = np.linalg.norm(
        cv2.sepFilter2D(profiles, cv2.CV_64F, STEEP_KERNEL[None], np.ones(1)), axis=2
    )
    best = np.where(np.abs(along) <= STEEP_REACH_PX, slope, -np.inf).argmax(axis=1)
    before, there, after = (slope[np.arange(len(points)), best + side] for side in (-1, 0, 1))
    bend = before - 2 * there + after  # a parabola through three samples has its top between them
    top = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0)
    return np.asarray(along[best] + np.clip(top, -1, 1) * STEEP_SAMPLE_PX, np.float64)


def _reconciled(
    inside: Float64Array, outside: Float64Array, reference: tuple[Float64Array, Float64Array]
) -> tuple[Float64Array, Float64Array]:
    """The bands' colours put right by what is known: a band may lie across the boundary, or in the food's shadow."""
    reference_inside, reference_outside = reference
    is_food = _squared(inside - reference_inside) < _squared(inside - reference_outside)
    inside = np.where(is_food, 0.5 * (inside + reference_inside), reference_inside)
    is_nearer = _squared(reference_outside - inside) < _squared(outside - inside)
    return inside, np.where(is_nearer, reference_outside, outside)


def _squared(difference: Float64Array) -> Float64Array:
    """(n, 1) squared length."""
    return np.asarray((difference**2).sum(axis=1, keepdims=True), np.float64)


def _profiles(
    lab: Float32Array, points: Float64Array, normals: Float64Array, along: Float64Array
) -> Float64Array:
    """(n, len(along), 3) colours along each normal."""
    where = points[:, None] + normals[:, None] * along[None, :, None]
    return np.asarray(sampled(lab, where, beyond=None), np.float64)


def _around(values: Float64Array, width: int) -> Float64Array:
    """Mean over neighbours on a closed ring, along the first axis."""
    half = width // 2
    padded = np.concatenate([values[-half:], values, values[:half]])
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(padded, axis=0)])
    return np.asarray((total[width:] - total[:-width]) / width, np.float64)


def _median(values: Float64Array) -> Float64Array:
    """Running median of five on a closed ring."""
    return np.median([np.roll(values, shift) for shift in range(-2, 3)], axis=0)


def _smoothed(line: Float64Array, width: int) -> Float64Array:
    kernel = np.hanning(width + 2)[1:-1]
    padded = np.concatenate([line[-(width // 2) :], line, line[: width // 2]])
    return np.column_stack(
        [np.convolve(padded[:, axis], kernel / kernel.sum(), "valid") for axis in (0, 1)]
    )


def _evenly(line: Float64Array) -> Float64Array:
    """A closed line's points at equal distances."""
    closed = np.concatenate([line, line[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    count = max(int(MIN_RING_PX), int(length[-1] / STEP_PX))
    at = np.arange(count) * length[-1] / count
    return np.column_stack([np.interp(at, length, closed[:, axis]) for axis in (0, 1)])


def _normals(points: Float64Array) -> Float64Array:
    """(n, 2) of length one, square to the ring, to one and the same side of it."""
    tangent = np.roll(points, -2, axis=0) - np.roll(points, 2, axis=0)
    square = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    return np.asarray(
        square / np.maximum(np.linalg.norm(square, axis=1, keepdims=True), 1e-9), np.float64
    )


def _sample(image: Float32Array, points: Float64Array) -> Float64Array:
    return np.asarray(sampled(image, points), np.float64).ravel()
