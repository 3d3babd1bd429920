"""A form fitted to what the views show of one food: outlines, parallax, the support; maximum a posteriori.

Evidence (Seen) + a family with its start (forms.py) -> unknowns, their covariance, the volume. Levenberg's and
Marquardt's method, from a tolerance as wide as the start is off to none (graduated non-convexity).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from app.core.units import ml_from_mm3
from app.vision.geometry.mesh import enclosed_gradient_mm2, enclosed_mm3
from app.vision.model import Float64Array
from app.vision.solids import side_view
from app.vision.solids.forms import COARSE, EXACT, Form
from app.vision.solids.measured_item import MOST_SD
from app.vision.solids.misfits import NO_POSE, Misfits, misfits, uncovered
from app.vision.solids.seen import Seen
from app.vision.tuning import TUNING


@dataclass(frozen=True, slots=True)
class _Prior:
    """Prior of a form's unknowns: (k,) its middle and (k, k) its precision."""

    expected: Float64Array
    precision: Float64Array


@dataclass(frozen=True)
class FormAt:
    """A form at unknowns (k,), and how it fits there what is seen.

    pose: (p,) of the side view. cells: COARSE or FINE.
    """

    form: Form
    cells: int
    unknowns: Float64Array
    pose: Float64Array
    prior: _Prior
    misfits: Misfits

    def cost(self, tolerance: float = 1.0) -> float:
        """-2 log of the posterior, all that a step is judged by."""
        apart = self._from_expected
        return self.misfits.loss(tolerance) + float(apart @ self.prior.precision @ apart)

    def linearised(self, tolerance: float = 1.0) -> tuple[Float64Array, Float64Array]:
        """(k + p, k + p) Gauss-Newton's matrix and (k + p,) half the gradient."""
        weighted = self._jacobian * self.misfits.precision(tolerance)
        apart = self._from_expected
        slope = weighted @ self.misfits.residual_px + self.prior.precision @ apart
        return weighted @ self._jacobian.T + self.prior.precision, slope

    @property
    def _from_expected(self) -> Float64Array:
        return np.concatenate([self.unknowns, self.pose]) - self.prior.expected

    @cached_property
    def _jacobian(self) -> Float64Array:
        by_vertex = self.form.moves_along(
            self.unknowns, self.cells, self.misfits.vertex, self.misfits.by_point
        )
        by_form = np.add.reduceat(by_vertex, self.misfits.begins, axis=1)
        by_pose = self.misfits.by_pose
        return by_form if by_pose is None else np.vstack([by_form, by_pose.T])


@dataclass(frozen=True)
class FormFit:
    """A form where its posterior is at a maximum. cost: -2 log of it there.

    uncovered: how many observations the part of the food's mask would be that a fine fit does not cover.

    What a coarse fit never needs (the volume, its spread, the evidence) is computed when it is first asked for.
    """

    at: FormAt
    cost: float
    uncovered: float = 0.0

    @property
    def form(self) -> Form:
        """Family and start."""
        return self.at.form

    @property
    def unknowns(self) -> Float64Array:
        """(k,) at the maximum."""
        return self.at.unknowns

    @property
    def observations(self) -> float:
        """Number of independent observations that took part."""
        return float(self.at.misfits.weight.sum())

    @cached_property
    def evidence(self) -> float:
        """As a cost, -2 log: with the price of what had to be fitted, log of det(precision times prior variance)."""
        log_occam = float(np.linalg.slogdet(self._normal)[1]) - self.form.prior_log_determinant
        return (
            self.cost + TUNING.unexplained_loss * self.uncovered + TUNING.occam_weight * log_occam
        )

    @cached_property
    def volume_ml(self) -> float:
        """Volume of the form's finest mesh."""
        vertices, mesh = self.form.vertices(self.unknowns, EXACT), self.form.topology(EXACT)
        return ml_from_mm3(enclosed_mm3(vertices, mesh.faces))

    @cached_property
    def volume_sd_ml(self) -> float:
        """By the covariance of the unknowns."""
        form, cells = self.form, self.at.cells
        vertices = form.vertices(self.unknowns, cells)
        by_vertex = enclosed_gradient_mm2(vertices, form.topology(cells))
        moves = form.moves_along(self.unknowns, cells, np.arange(len(vertices)), by_vertex)
        gradient = np.concatenate([moves.sum(axis=1), np.zeros(len(self.at.pose))])
        variance = float(gradient @ _solved(self._normal, gradient))
        return ml_from_mm3(float(np.sqrt(max(variance, 0.0))))

    @property
    def is_determined(self) -> bool:
        """Whether the 90 % interval of the volume lies within a third and three times of it.

        It does not for a ring as thin as a wire, which follows an outline and touches no surface.
        """
        return self.volume_sd_ml < MOST_SD * self.volume_ml

    @cached_property
    def _normal(self) -> Float64Array:
        return self.at.linearised()[0]


def form_at(
    form: Form,
    unknowns: Float64Array,
    cells: int,
    seen: Seen,
    pose: Float64Array = NO_POSE,
    prior: _Prior | None = None,
) -> FormAt | None:
    """Return the form where the unknowns (k,) place it; None where nothing of the food meets it.

    pose: of the side view, if there is one. prior: the form's own, if it was computed before.
    """
    apart = misfits(form, unknowns, cells, seen, pose)
    if apart is None:
        return None
    return FormAt(form, cells, unknowns, pose, prior or _prior_of(form, pose), apart)


def _prior_of(form: Form, pose: Float64Array) -> _Prior:
    """Return the prior of a form's unknowns, and of a pose about where it begins."""
    expected, precision = form.expected, form.prior_precision
    if len(pose) == 0:
        return _Prior(expected, precision)
    of_pose, pose_precision = side_view.pose_prior(pose)
    count = len(expected)
    both = np.zeros((count + len(pose), count + len(pose)))
    both[:count, :count], both[count:, count:] = precision, pose_precision
    return _Prior(np.concatenate([expected, of_pose]), both)


def fit_form(
    form: Form,
    seen: Seen,
    cells: int,
    start: Float64Array | None = None,
    most_rounds: int = TUNING.most_rounds,
    pose: Float64Array = NO_POSE,
) -> FormFit | None:
    """Fit from `start` (or the form's own); None where nothing of the food meets the form. cells: COARSE or FINE.

    pose: where the side view's begins, if it was fitted before.
    """
    start = form.start if start is None else start
    if seen.side is not None and len(pose) == 0:
        pose = seen.side.begin(form.vertices(start, cells))
    now = form_at(form, start, cells, seen, pose)
    if now is None:
        return None
    prior, stride, count = now.prior, form.stride, len(start)
    if len(pose):
        stride = np.concatenate([stride, side_view.STRIDE])
    tolerance = float(np.clip(now.misfits.middle, 1.0, TUNING.widest))
    damping, least, most = TUNING.damping
    settled = TUNING.settled_coarse if cells == COARSE else TUNING.settled_fine
    is_settled = False
    for _ in range(most_rounds):
        normal, slope = now.linearised(tolerance)
        cost = now.cost(tolerance)
        while damping <= most:
            step = -_solved(normal + damping * np.diag(np.diag(normal)), slope)
            step /= max(1.0, float(np.abs(step / stride).max()))
            promised = -float((2 * slope + normal @ step) @ step)
            is_settled = tolerance == 1.0 and promised < settled
            if is_settled:
                break
            unknowns = form.bounded(now.unknowns + step[:count])
            trial = form_at(form, unknowns, cells, seen, now.pose + step[count:], prior)
            fall = -1.0 if trial is None else cost - trial.cost(tolerance)
            if trial is not None and fall > 0:
                now = trial
                is_settled = tolerance == 1.0 and fall < settled
                damping = max(damping / TUNING.damping_fall, least)
                break
            damping *= TUNING.damping_rise
        if is_settled:
            break
        damping = min(damping, most)
        tolerance = max(1.0, tolerance / 2)
    missed = 0.0 if cells == COARSE else uncovered(form, now.unknowns, seen)
    return FormFit(now, now.cost(), missed)


def _solved(normal: Float64Array, right: Float64Array) -> Float64Array:
    """Solve normal @ x = right, for the shortest x where the food shows too little of the form to tell some unknown."""
    try:
        return np.asarray(np.linalg.solve(normal, right), np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(normal, right, rcond=None)[0], np.float64)
