"""The volume that several families of form leave together, each by its evidence, and its doubt.

Fits of one food -> volume, 90 % interval, the likeliest form's closed shape and slices.
"""

from collections.abc import Collection, Sequence

import numpy as np

from app.vision.geometry.mesh import ClosedShape
from app.vision.geometry.slices import Slice
from app.vision.model import Float64Array
from app.vision.solids.form_fit import FormFit
from app.vision.solids.form_prior import FAMILIES_OF_FORM, FormPrior, LikelyForms
from app.vision.solids.forms import EXACT
from app.vision.solids.measured_item import NORMAL_90, Volume
from app.vision.solids.sections import cut_sections
from app.vision.tuning import SINGLE_TUNING, TUNING

Flags = tuple[str, ...]  # stable codes


def average_forms(
    fits: Sequence[FormFit],
    pair_sd: float,
    prior: FormPrior | None,
    likely: LikelyForms | None = None,
    *,
    is_single: bool,
) -> tuple[Volume, float, Flags]:
    """The families' volumes averaged by their evidence and what is known of the form; the likeliest one's slices.

    Also the height that it rests at, mm, and flags. pair_sd: relative, what all foods of the photographs share.
    likely: of a single view's food whose form no person says; it goes before prior.
    """
    log_evidence, misfit = _log_evidence(fits)
    weights = np.exp(log_evidence)
    if is_single:
        weights *= _equal_forms([fit.form.name for fit in fits])
    flags: Flags = ()
    if likely is not None:
        weights *= [likely.factor(fit.form.name) for fit in fits]
    elif prior is not None:
        names = [fit.form.name for fit in fits]
        weights *= [prior.factor(name) for name in names]
        best_last = zip(names[::-1], log_evidence[::-1].tolist(), strict=True)
        flags = ("form_unlikely",) if prior.is_unlikely(dict(best_last)) else ()
    weights /= weights.sum()
    best = fits[int(weights.argmax())]
    logs = np.log([fit.volume_ml for fit in fits])
    spreads = np.array([fit.volume_sd_ml / fit.volume_ml for fit in fits]) * np.sqrt(misfit)
    mean = float(weights @ logs)
    vertices, mesh = best.form.vertices(best.unknowns, EXACT), best.form.topology(EXACT)
    support_mm = float(vertices[:, 2].min())
    rest = np.array([TUNING.flat_rest_sd if fit.form.is_flat else TUNING.rest_sd for fit in fits])
    if is_single:
        tuning = SINGLE_TUNING
        rest = np.array(
            [tuning.heap_rest_sd if fit.form.name == "heap" else tuning.rest_sd for fit in fits]
        )
        if len(best.at.pose):
            rest = np.full(len(fits), tuning.side_rest_sd)
    variance = float(weights @ (spreads**2 + (logs - mean) ** 2 + rest**2))
    item_sd = float(np.hypot(np.sqrt(variance), TUNING.foot_sd_mm / np.ptp(vertices[:, 2])))
    slices = cut_sections(vertices, mesh.faces, support_mm)
    middle, rest = vertices[:, :2].mean(axis=0), vertices - [0.0, 0.0, support_mm]
    shape = ClosedShape(rest, mesh.faces)
    return (
        log_normal_volume(float(np.exp(mean)), pair_sd, item_sd, slices, middle, rest, shape),
        support_mm,
        flags,
    )


def likely_fits(fits: Sequence[FormFit], hinted_families: Collection[str] = ()) -> list[FormFit]:
    """Return the fits whose weight is not negligible or whose family a hint names, the best first."""
    if not fits:
        return []
    log_evidence, _ = _log_evidence(fits)
    is_likely = log_evidence > np.log(TUNING.least_weight)
    return [
        fit
        for fit, likely in zip(fits, is_likely, strict=True)
        if likely or fit.form.name in hinted_families
    ]


def _log_evidence(fits: Sequence[FormFit]) -> tuple[Float64Array, float]:
    """(n,) logarithm of each fit's evidence over the best one's, which is the first, and the best one's misfit."""
    costs = np.array([fit.evidence for fit in fits])
    # its own size tells what a difference is worth
    misfit = max(1.0, costs[0] / max(fits[0].observations, 1.0))
    return -0.5 * (costs - costs[0]) / (TUNING.temper * misfit), misfit


def _equal_forms(names: Sequence[str]) -> Float64Array:
    """(n,) factors by which each form weighs alike before it is seen, however many families stand for it."""
    forms = [frozenset(families) for form, families in FAMILIES_OF_FORM.items() if form != "lying"]
    of_name = [next((form for form in forms if name in form), frozenset({name})) for name in names]
    return np.array([1.0 / of_name.count(form) for form in of_name])


def log_normal_volume(
    volume_ml: float,
    pair_sd: float,
    item_sd: float,
    slices: tuple[Slice, ...],
    middle_mm: Float64Array,
    completed_mm: Float64Array,
    shape: ClosedShape,
) -> Volume:
    """A volume with its 90 % interval, log-normal. pair_sd, item_sd: relative, see ItemEstimate."""
    volume_ml, factor = float(volume_ml), float(np.exp(NORMAL_90 * np.hypot(pair_sd, item_sd)))
    return Volume(
        volume_ml=volume_ml,
        interval_ml=(volume_ml / factor, volume_ml * factor),
        relative_sd={"pair": pair_sd, "item": item_sd},
        form="ellipse",
        centre_mm=middle_mm,
        slices=slices,
        completed_mm=completed_mm,
        shape=shape,
    )
