"""Robust least squares of a few unknowns, with the Gauss-Newton matrix that is their inverse covariance."""

from collections.abc import Callable

import numpy as np

from app.vision.model import Float64Array

OUTLIER_SD = 3.0  # beyond, a residual pulls only linearly
MAX_STEPS = 20
# in log likelihood: what is left moves no unknown by a fifth of its own uncertainty
LEAST_PROGRESS = 0.02
DAMPINGS = (0.0, *np.geomspace(1e-10, 1e6, 17))


def minimise(
    residual: Callable[[Float64Array], Float64Array], start: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """The least of a sum and its Gauss-Newton matrix before the last step, which is the covariance's inverse.

    residual: in standard deviations. Levenberg and Marquardt on sum of rho(r^2), rho(s) = 2 (sqrt(1 + s) - 1) in units
    of OUTLIER_SD (soft l1).

    Differences stand for derivatives. Few unknowns, near the optimum: a general solver takes three times as long.
    Seen from above, focal length and distance change hardly any residual together and much each alone: the least
    damping would keep both where they began. Each step is tried undamped first, and what an undamped step promises
    ends the search, not what a damped one brought.
    """
    unknowns, normal = start, np.eye(len(start))
    now = residual(unknowns)
    cost = _soft_cost(now)
    steps = 1e-6 * np.maximum(1.0, np.abs(start))
    for _ in range(MAX_STEPS):
        jacobian = np.stack(
            [(residual(unknowns + step) - now) / step.sum() for step in np.diag(steps)], axis=1
        )
        weight = 1.0 / np.sqrt(1.0 + (now / OUTLIER_SD) ** 2)
        normal = jacobian.T @ (jacobian * weight[:, None])
        gradient = jacobian.T @ (now * weight)
        promised = 0.5 * float(gradient @ np.linalg.solve(normal, gradient))
        progress = 0.0
        for damping in DAMPINGS:
            trial = unknowns - np.linalg.solve(
                normal + damping * np.diag(np.diag(normal)), gradient
            )
            then = residual(trial)
            progress = cost - _soft_cost(then)
            if progress >= 0:
                unknowns, now, cost = trial, then, cost - progress
                break
        if promised < LEAST_PROGRESS or progress <= 0:
            break
    return unknowns, normal


def _soft_cost(residuals: Float64Array) -> float:
    return float(OUTLIER_SD**2 * (np.sqrt(1.0 + (residuals / OUTLIER_SD) ** 2) - 1.0).sum())
