"""An ellipse in a plane, of pixels or of mm: its points, what lies beyond it, and the one that most points lie on."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.model import Float64Array

POINTS = 72
DIRECTIONS = np.column_stack(
    [call(np.arange(POINTS) * (2 * np.pi / POINTS)) for call in (np.cos, np.sin)]
)
DRAWN, LEAST_ON_IT = 6, 9  # points through which one is tried, and is fitted again


@dataclass(frozen=True, slots=True)
class Ellipse:
    """centre: (2,). half: (2,) half-axes. turn: of the first one, radians."""

    centre: Float64Array
    half: Float64Array
    turn: float

    @property
    def radius(self) -> float:
        """Return the radius of the circle of its area."""
        return float(np.sqrt(self.half.prod()))

    @property
    def axes(self) -> Float64Array:
        """Return the directions of the half-axes, (2, 2), as rows."""
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cosine, sine], [-sine, cosine]])

    def points(self) -> Float64Array:
        """Return POINTS places (n, 2) along it, evenly by angle."""
        return self.centre + (DIRECTIONS * self.half) @ self.axes

    def normals(self) -> Float64Array:
        """Return the outward normals (n, 2) at the points."""
        across = (DIRECTIONS / self.half) @ self.axes
        return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True), np.float64)

    def beyond(self, places: Float64Array) -> Float64Array:
        """Return how far (...,) places (..., 2) lie outside it, to first order."""
        apart = (places - self.centre) @ self.axes.T
        radius = np.hypot(*np.moveaxis(apart / self.half, -1, 0))
        reach = np.hypot(apart[..., 0], apart[..., 1])
        return np.asarray((radius - 1) * reach / np.maximum(radius, 1e-6), np.float64)


def fit_ellipse(
    points: Float64Array,
    near: float,
    trials: int,
    is_possible: Callable[[Ellipse], bool],
    score: Callable[[Ellipse], float],
) -> Ellipse | None:
    """Return the possible ellipse of the highest score among those through draws of points (n, 2) (RANSAC).

    It is fitted again to the points that are near it, where that does not lower the score.
    """
    draws = np.random.default_rng(0)
    best: tuple[float, Ellipse] | None = None
    for _ in range(trials):
        ellipse = _through(points[draws.choice(len(points), DRAWN, replace=False)])
        if ellipse is None or not is_possible(ellipse):
            continue
        scored = score(ellipse)
        if best is None or scored > best[0]:
            best = scored, ellipse
    if best is None:
        return None
    on_it = points[np.abs(best[1].beyond(points)) < near]
    again = _through(on_it) if len(on_it) >= LEAST_ON_IT else None
    is_better = again is not None and is_possible(again) and score(again) >= best[0]
    return again if is_better else best[1]


def _through(points: Float64Array) -> Ellipse | None:
    (x, y), size, degrees = cv2.fitEllipseDirect(points.astype(np.float32))
    values = np.array([x, y, *size, np.radians(degrees)], np.float64)
    if not np.isfinite(values).all():
        return None
    return Ellipse(values[:2], values[2:4] / 2, float(values[4]))
