"""A coin in a photograph: the ellipse of its edge.

Photograph, camera, diameter -> the ellipse that is most likely the coin's, in the photograph's
pixels. Circles proposed by gradients (Hough) are refined to ellipses on their edge; how much of
the edge is seen, how round it is, how far away a coin of that size would be, and how little colour
it has, decide.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.geometry.pictures import blurred, lab_bytes, sampled
from app.vision.intrinsics import Camera
from app.vision.known_object import KnownObject
from app.vision.model import Float32Array, Float64Array, ImageArray, Int64Array, Photo

SIDE_PX = 816  # of the reduced picture
SMOOTH_PX, SMOOTH_EDGE_PX = 1.2, 0.8  # to propose, and to refine
STRENGTHS = (150.0, 50.0, 50.0)  # of an edge, in lightness and in either colour
SQUEEZES = (1.0, 0.8, 0.6)  # of the picture's width, in which a coin seen at a slant is a circle
ROUNDNESS, GRID_PX, APART_PX = 0.7, 1.5, 8.0  # of proposed circles, see cv2.HOUGH_GRADIENT_ALT
DISTANCE_MM = (130.0, 900.0)  # of a phone from the coin
USUAL_MM, USUAL_LOG_SD = (
    350.0,
    0.35,
)  # of the same: from close-ups of one food to a table from a chair
RAYS = 72
REACHES = (0.3, 0.18, 0.1)  # of the radius, across the edge, in each round
STEP_PX, EDGE_PX = 0.5, 2.0  # along a ray; over which an edge's contrast is taken
LEAST_STEP, STEP_SHARE = 6.0, 0.35  # contrast of an edge, absolute and by the median of the rays
OUTER_SHARE = 0.4  # of a ray's strongest contrast, that the outermost edge has
TRIALS, DRAWN = 60, 6
ON_EDGE = (1.2, 0.03)  # px, and share of the radius: what is on the ellipse
LEAST_ASPECT, RADII = 0.4, (0.6, 1.5)  # of an ellipse; of its radius by the proposed circle's
LEAST_COVER = 0.3
SAME_PX, SAME_SHARE = 2.0, 0.05
INSIDE, AROUND = -0.12, 1.6  # of the radius, clear of the edge; of the window around
# Log odds that an ellipse is the coin, beside how far away it would be: a logistic regression on
# 152 photographs of ECUSTFD and 56 rendered ones with its coins drawn in, among 2,100 others. By
# cover, aspect, chroma / 10, spread of colour / 10, and one.
WEIGHTS = (12.6, 1.5, -0.89, -0.65, -8.0)
LEAST_ODDS = -1.0  # one in twenty that were right had less
MOST_LIKELY = 5


@dataclass(frozen=True, slots=True)
class Ellipse:
    """centre_px: (2,). half_px: (2,) half-axes. turn: of the first one, radians. odds: logarithm, of being the coin."""

    centre_px: Float64Array
    half_px: Float64Array
    turn: float
    odds: float = 0.0

    @property
    def radius_px(self) -> float:
        """Of the circle of its area."""
        return float(np.sqrt(self.half_px.prod()))

    @property
    def axes(self) -> Float64Array:
        """(2, 2) directions of the half-axes, as rows."""
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cosine, sine], [-sine, cosine]])

    def points(self, count: int = RAYS) -> Float64Array:
        """(count, 2) px evenly along it, by angle."""
        return np.asarray(
            self.centre_px + (_directions(count) * self.half_px) @ self.axes, np.float64
        )

    def normals(self, count: int = RAYS) -> Float64Array:
        """(count, 2) outward at the points."""
        across = (_directions(count) / self.half_px) @ self.axes
        return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True), np.float64)

    def beyond_px(self, places: Float64Array) -> Float64Array:
        """(...,) distance of places (..., 2) outside it, to first order."""
        apart = (places - self.centre_px) @ self.axes.T
        radius = np.hypot(*np.moveaxis(apart / self.half_px, -1, 0))
        reach = np.hypot(apart[..., 0], apart[..., 1])
        return np.asarray((radius - 1) * reach / np.maximum(radius, 1e-6), np.float64)

    def scaled(self, factor: float) -> "Ellipse":
        """Return it in a picture `factor` times as large; centres of pixels are at whole numbers."""
        centre = (self.centre_px + 0.5) * factor - 0.5
        return Ellipse(centre, self.half_px * factor, self.turn, self.odds)


def find_round_objects(
    photo: Photo, camera: Camera, known: KnownObject, side: str
) -> list[Ellipse] | Failure:
    """Return what may be the coin's edge, the likeliest first, px of the photograph.

    side: "left" or "right". Failure "marker_not_found".
    """
    pixels = photo.pixels_bgr
    factor = min(1.0, SIDE_PX / max(pixels.shape[:2]))
    small = _resized(pixels, factor)
    lab = blurred(lab_bytes(small), SMOOTH_EDGE_PX)
    likely = [
        ellipse.scaled(1.0 / factor)
        for ellipse in _ellipses(small, lab, camera.fx * factor * known.diameter_mm / 2)
        if ellipse.odds > LEAST_ODDS
    ]
    if not likely:
        return Failure(
            "marker_not_found",
            f"No coin was found in the {side} photograph.",
            "Lay the coin flat beside the plate, whole and in the light, nothing on it.",
        )
    return sorted(likely, key=lambda ellipse: -ellipse.odds)[:MOST_LIKELY]


def _resized(pixels: ImageArray, factor: float) -> ImageArray:
    if factor == 1.0:
        return pixels
    return np.asarray(
        cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8
    )


def _ellipses(
    image_bgr: ImageArray, lab: Float32Array, radius_at_one_mm: float
) -> Iterator[Ellipse]:
    """Yield the ellipses of the picture, each once, with their odds. radius_at_one_mm: of the coin, px mm."""
    proposed: list[Ellipse] = []
    kept: list[Ellipse] = []
    radii = [radius_at_one_mm / distance for distance in reversed(DISTANCE_MM)]
    for start in _proposals(image_bgr, (radii[0], radii[1])):
        if any(_is_same(start, other, 0.2 * other.radius_px, 0.15) for other in proposed):
            continue
        proposed.append(start)
        refined = _refined(lab, start)
        if refined is None:
            continue
        ellipse, cover = refined
        if cover < LEAST_COVER or any(
            _is_same(ellipse, other, SAME_PX, SAME_SHARE) for other in kept
        ):
            continue
        odds = _odds(lab, ellipse, cover, radius_at_one_mm)
        if odds is not None:
            kept.append(ellipse)
            yield replace(ellipse, odds=odds)


def _proposals(image_bgr: ImageArray, radii_px: tuple[float, float]) -> Iterator[Ellipse]:
    """Yield the ellipses, upright ones, that edges of lightness or colour propose."""
    smooth = cv2.GaussianBlur(lab_bytes(image_bgr).astype(np.uint8), (0, 0), SMOOTH_PX)
    for squeeze in SQUEEZES:
        narrow = cv2.resize(smooth, None, fx=squeeze, fy=1.0, interpolation=cv2.INTER_AREA)
        for channel, strength in zip(cv2.split(narrow), STRENGTHS, strict=True):
            circles = cv2.HoughCircles(
                channel,
                cv2.HOUGH_GRADIENT_ALT,
                GRID_PX,
                APART_PX,
                param1=strength,
                param2=ROUNDNESS,
                minRadius=int(radii_px[0] * squeeze),
                maxRadius=int(radii_px[1]),
            )
            if circles is None:
                continue
            for x, y, radius in np.asarray(circles, np.float64).reshape(-1, circles.shape[-1])[
                :, :3
            ]:
                centre = np.array([(x + 0.5) / squeeze - 0.5, y])
                yield Ellipse(centre, np.array([radius / squeeze, radius]), 0.0)


def _is_same(ellipse: Ellipse, other: Ellipse, apart_px: float, share: float) -> bool:
    apart = float(np.linalg.norm(ellipse.centre_px - other.centre_px))
    return apart < apart_px and abs(ellipse.radius_px / other.radius_px - 1) < share


def _directions(count: int) -> Float64Array:
    turn = np.arange(count) * (2 * np.pi / count)
    return np.column_stack([np.cos(turn), np.sin(turn)])


def _refined(lab: Float32Array, start: Ellipse) -> tuple[Ellipse, float] | None:
    """Return the ellipse of the outermost edges near a start, and the share of rays that end on it."""
    radius = start.radius_px
    ellipse, cover = start, 0.0
    for reach in REACHES:
        offsets = np.arange(
            -max(3.0, reach * radius), max(3.0, reach * radius) + STEP_PX / 50, STEP_PX
        )
        rim, normals = ellipse.points(), ellipse.normals()
        places = rim[:, None] + offsets[None, :, None] * normals[:, None]
        colours = np.asarray(sampled(lab, places, beyond=None), np.float32)
        lag = int(EDGE_PX / STEP_PX)
        steps = np.linalg.norm(colours[:, lag:] - colours[:, :-lag], axis=-1)
        outermost = _outermost(steps)
        step = steps[np.arange(RAYS), outermost]
        edges = rim + ((offsets[lag:] + offsets[:-lag]) / 2)[outermost][:, None] * normals
        is_edge = step > max(LEAST_STEP, STEP_SHARE * float(np.median(step)))
        better = _fitted(edges[is_edge], radius)
        if better is None:
            return None
        ellipse = better
        on_edge = np.abs(ellipse.beyond_px(edges)) < max(ON_EDGE[0], ON_EDGE[1] * radius)
        cover = float(np.mean(is_edge & on_edge))
    return ellipse, cover


def _outermost(steps: Float32Array) -> Int64Array:
    """Return the place (n,) of the outermost strong edge along each ray (n, m): a coin's rim has an inner edge, too."""
    is_peak = np.zeros(steps.shape, np.bool_)
    is_peak[:, 1:-1] = (steps[:, 1:-1] >= steps[:, :-2]) & (steps[:, 1:-1] > steps[:, 2:])
    is_peak &= steps > OUTER_SHARE * steps.max(axis=1, keepdims=True)
    last = steps.shape[1] - 1 - is_peak[:, ::-1].argmax(axis=1)
    return np.asarray(np.where(is_peak.any(axis=1), last, steps.argmax(axis=1)), np.int64)


def _fitted(edges: Float64Array, radius: float) -> Ellipse | None:
    """Return the ellipse that most edges (n, 2) lie on (RANSAC)."""
    if len(edges) < 2 * DRAWN:
        return None
    near_px = max(ON_EDGE[0], ON_EDGE[1] * radius)
    draws = np.random.default_rng(0)
    most, best = 0, None
    for _ in range(TRIALS):
        ellipse = _through(edges[draws.choice(len(edges), DRAWN, replace=False)], radius)
        if ellipse is None:
            continue
        count = int(np.count_nonzero(np.abs(ellipse.beyond_px(edges)) < near_px))
        if count > most:
            most, best = count, ellipse
    if best is None:
        return None
    return _through(edges[np.abs(best.beyond_px(edges)) < near_px], radius) or best


def _through(points: Float64Array, radius: float) -> Ellipse | None:
    """Return the ellipse through points (n, 2), if it may be a coin's."""
    if len(points) < DRAWN:
        return None
    (x, y), size, degrees = cv2.fitEllipseDirect(points.astype(np.float32))
    half = np.array(size, np.float64) / 2
    if not np.isfinite([x, y, *half]).all() or half.min() < LEAST_ASPECT * half.max():
        return None
    if not RADII[0] * radius < np.sqrt(half.prod()) < RADII[1] * radius:
        return None
    return Ellipse(np.array([x, y], np.float64), half, float(np.radians(degrees)))


def _odds(
    lab: Float32Array, ellipse: Ellipse, cover: float, radius_at_one_mm: float
) -> float | None:
    """Return the logarithm of the odds that an ellipse is the coin; None where too little of it is in the picture."""
    reach = AROUND * 2 * float(ellipse.half_px.max())
    low = np.maximum(np.floor(ellipse.centre_px - reach), 0).astype(np.int64)
    high = np.ceil(ellipse.centre_px + reach).astype(np.int64)
    window = lab[low[1] : high[1], low[0] : high[0]]
    rows, columns = np.mgrid[: window.shape[0], : window.shape[1]]
    beyond = ellipse.beyond_px(np.stack([columns, rows], -1) + low)
    is_inside = beyond < INSIDE * ellipse.radius_px
    if np.count_nonzero(is_inside) < RAYS / 4:
        return None
    colours = window[is_inside]
    chroma = float(np.hypot(*(np.median(colours, axis=0)[1:] - 128.0)))
    spread = float(np.linalg.norm(colours.std(axis=0)))
    aspect = float(ellipse.half_px.min() / ellipse.half_px.max())
    distance = float(np.log(radius_at_one_mm / ellipse.radius_px / USUAL_MM)) / USUAL_LOG_SD
    facts = (cover, aspect, chroma / 10, spread / 10, 1.0)
    return float(np.dot(WEIGHTS, facts)) - distance**2 / 2
