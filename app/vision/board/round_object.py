"""A coin in a photograph: the ellipse of its edge.

Photograph, camera, diameter -> the ellipse that is most likely the coin's, in the photograph's
pixels. Circles proposed by gradients (Hough) are refined to ellipses on their edge; how much of
the edge is seen, how round it is, how far away a coin of that size would be, and how little colour
it has, decide.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.geometry.ellipse import POINTS, Ellipse, fit_ellipse
from app.vision.geometry.pictures import blurred, lab_bytes, sampled
from app.vision.intrinsics import Camera
from app.vision.known_object import KnownObject
from app.vision.model import Float32Array, Float64Array, Int64Array, Photo

SIDE_PX = 816  # of the reduced picture
SMOOTH_PX, SMOOTH_EDGE_PX = 1.2, 0.8  # to propose, and to refine
STRENGTHS = (150.0, 50.0, 50.0)  # of an edge, in lightness and in either colour
SQUEEZES = (1.0, 0.8, 0.6)  # of the picture's width, in which a coin seen at a slant is a circle
ROUNDNESS, GRID_PX, APART_PX = 0.7, 1.5, 8.0  # of proposed circles, see cv2.HOUGH_GRADIENT_ALT
DISTANCE_MM = (130.0, 900.0)  # of a phone from the coin
# of the same: from close-ups of one food to a table from a chair
USUAL_MM, USUAL_LOG_SD = 350.0, 0.35
REACHES = (0.3, 0.18, 0.1)  # of the radius, across the edge, in each round
LEAST_REACH_PX = 3.0
STEP_PX, LAG = 0.5, 4  # along a ray; steps over which an edge's contrast is taken
LEAST_STEP, STEP_SHARE = 6.0, 0.35  # contrast of an edge, absolute and by the median of the rays
OUTER_SHARE = 0.4  # of a ray's strongest contrast, that the outermost edge has
TRIALS = 60
ON_EDGE = (1.2, 0.03)  # px, and share of the radius: what is on the ellipse
LEAST_ASPECT, RADII = 0.4, (0.6, 1.5)  # of an ellipse; of its radius by the proposed circle's
LEAST_COVER = 0.3
# Middles, by the radius, and the ratio of radii, within which two are one: proposed, and refined.
SAME_PROPOSAL, SAME = (0.2, 0.15), (0.06, 0.05)
INSIDE = -0.12  # of the radius, clear of the edge
MIN_INSIDE_PX = 18
# Log odds that an ellipse is the coin, beside how far away it would be: a logistic regression on
# 303 photographs of ECUSTFD from above and, twice as heavy, 155 rendered ones with its coins drawn
# in, among 3,500 others. By cover, aspect, chroma / 10, spread of colour / 10, and one.
WEIGHTS = (17.2, 3.3, -1.15, -0.47, -14.3)
LEAST_ODDS = -1.0  # one in twenty that were right had less
MOST_LIKELY = 5


@dataclass(frozen=True, slots=True)
class MaybeCoin:
    """An ellipse, px, that may be the coin's edge. log_odds: that it is."""

    ellipse: Ellipse
    log_odds: float


def find_round_objects(
    photo: Photo, camera: Camera, known: KnownObject, side: str
) -> list[MaybeCoin] | Failure:
    """Return what may be the coin's edge, the likeliest first, px of the photograph.

    side: "left" or "right". Failure "marker_not_found".
    """
    factor = min(1.0, SIDE_PX / max(photo.pixels_bgr.shape[:2]))
    small = cv2.resize(photo.pixels_bgr, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    radius_at_one_mm = camera.fx * factor * known.diameter_mm / 2
    likely = [
        MaybeCoin(_enlarged(coin.ellipse, 1.0 / factor), coin.log_odds)
        for coin in _coins(lab_bytes(np.asarray(small, np.uint8)), radius_at_one_mm)
        if coin.log_odds > LEAST_ODDS
    ]
    if not likely:
        return Failure(
            "marker_not_found",
            f"No coin was found in the {side} photograph.",
            "Lay the coin flat beside the plate, whole and in the light, nothing on it.",
        )
    return sorted(likely, key=lambda coin: -coin.log_odds)[:MOST_LIKELY]


def _enlarged(ellipse: Ellipse, factor: float) -> Ellipse:
    """Return it in a picture `factor` times as large; centres of pixels are at whole numbers."""
    return Ellipse((ellipse.centre + 0.5) * factor - 0.5, ellipse.half * factor, ellipse.turn)


def _coins(lab: Float32Array, radius_at_one_mm: float) -> Iterator[MaybeCoin]:
    """Yield the ellipses of the picture, each once. radius_at_one_mm: of the coin, px mm."""
    smooth = blurred(lab, SMOOTH_EDGE_PX)
    proposed: list[Ellipse] = []
    kept: list[Ellipse] = []
    radii = [radius_at_one_mm / distance for distance in reversed(DISTANCE_MM)]
    for start in _proposals(lab, (radii[0], radii[1])):
        if any(_is_same(start, other, *SAME_PROPOSAL) for other in proposed):
            continue
        proposed.append(start)
        refined = _refined(smooth, start)
        if refined is None:
            continue
        ellipse, cover = refined
        if cover < LEAST_COVER or any(_is_same(ellipse, other, *SAME) for other in kept):
            continue
        log_odds = _log_odds(smooth, ellipse, cover, radius_at_one_mm)
        if log_odds is not None:
            kept.append(ellipse)
            yield MaybeCoin(ellipse, log_odds)


def _proposals(lab: Float32Array, radii_px: tuple[float, float]) -> Iterator[Ellipse]:
    """Yield the ellipses, upright ones, that edges of lightness or colour propose."""
    smooth = cv2.GaussianBlur(lab.astype(np.uint8), (0, 0), SMOOTH_PX)
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
            for x, y, radius in np.asarray(circles, np.float64)[..., :3].reshape(-1, 3):
                centre = np.array([(x + 0.5) / squeeze - 0.5, y])
                yield Ellipse(centre, np.array([radius / squeeze, radius]), 0.0)


def _is_same(ellipse: Ellipse, other: Ellipse, apart: float, share: float) -> bool:
    """Return whether two are one: middles, by the other's radius, and the ratio of radii."""
    between = float(np.linalg.norm(ellipse.centre - other.centre))
    return between < apart * other.radius and abs(ellipse.radius / other.radius - 1) < share


def _refined(lab: Float32Array, start: Ellipse) -> tuple[Ellipse, float] | None:
    """Return the ellipse of the outermost edges near a start, and the share of rays that end on it."""
    radius = start.radius
    near_px = max(ON_EDGE[0], ON_EDGE[1] * radius)
    ellipse, cover = start, 0.0

    def may_be_coin(ellipse: Ellipse) -> bool:
        small, large = float(ellipse.half.min()), float(ellipse.half.max())
        return small > LEAST_ASPECT * large and RADII[0] < ellipse.radius / radius < RADII[1]

    for reach in REACHES:
        edges = _edges(lab, ellipse, max(LEAST_REACH_PX, reach * radius))
        if len(edges) < LEAST_COVER * POINTS:
            return None
        cover_by = partial(_cover, edges, near_px)
        better = fit_ellipse(edges, near_px, TRIALS, may_be_coin, cover_by)
        if better is None:
            return None
        ellipse, cover = better, cover_by(better)
    return ellipse, cover


def _cover(edges: Float64Array, near_px: float, ellipse: Ellipse) -> float:
    """Return the share of all rays that end on the ellipse."""
    return float(np.count_nonzero(np.abs(ellipse.beyond(edges)) < near_px)) / POINTS


def _edges(lab: Float32Array, ellipse: Ellipse, reach_px: float) -> Float64Array:
    """Return the outermost edges (n, 2) along rays across an ellipse, of those that have one."""
    offsets = np.arange(-reach_px, reach_px + STEP_PX / 2, STEP_PX)
    rim, normals = ellipse.points(), ellipse.normals()
    places = rim[:, None] + offsets[None, :, None] * normals[:, None]
    colours = sampled(lab, places, beyond=None)
    steps = np.linalg.norm(colours[:, LAG:] - colours[:, :-LAG], axis=-1)
    outermost = _outermost(steps)
    step = steps[np.arange(len(steps)), outermost]
    edges = rim + ((offsets[LAG:] + offsets[:-LAG]) / 2)[outermost][:, None] * normals
    is_edge = step > max(LEAST_STEP, STEP_SHARE * float(np.median(step)))
    return np.asarray(edges[is_edge], np.float64)


def _outermost(steps: Float32Array) -> Int64Array:
    """Return the place (n,) of the outermost strong edge along each ray (n, m): a coin's rim has an inner edge, too."""
    is_peak = np.zeros(steps.shape, np.bool_)
    is_peak[:, 1:-1] = (steps[:, 1:-1] >= steps[:, :-2]) & (steps[:, 1:-1] > steps[:, 2:])
    is_peak &= steps > OUTER_SHARE * steps.max(axis=1, keepdims=True)
    last = steps.shape[1] - 1 - is_peak[:, ::-1].argmax(axis=1)
    return np.asarray(np.where(is_peak.any(axis=1), last, steps.argmax(axis=1)), np.int64)


def _log_odds(
    lab: Float32Array, ellipse: Ellipse, cover: float, radius_at_one_mm: float
) -> float | None:
    """Return the logarithm of the odds that an ellipse is the coin; None where too little of it is in the picture."""
    reach = float(ellipse.half.max())
    low = np.maximum(np.floor(ellipse.centre - reach), 0).astype(np.int64)
    high = np.ceil(ellipse.centre + reach).astype(np.int64)
    window = lab[low[1] : high[1], low[0] : high[0]]
    rows, columns = np.mgrid[: window.shape[0], : window.shape[1]]
    is_inside = ellipse.beyond(np.stack([columns, rows], -1) + low) < INSIDE * ellipse.radius
    if np.count_nonzero(is_inside) < MIN_INSIDE_PX:
        return None
    colours = window[is_inside]
    chroma = float(np.hypot(*(np.median(colours, axis=0)[1:] - 128.0)))
    spread = float(np.linalg.norm(colours.std(axis=0)))
    aspect = float(ellipse.half.min() / ellipse.half.max())
    distance = float(np.log(radius_at_one_mm / ellipse.radius / USUAL_MM)) / USUAL_LOG_SD
    facts = (cover, aspect, chroma / 10, spread / 10, 1.0)
    return float(np.dot(WEIGHTS, facts)) - distance**2 / 2
