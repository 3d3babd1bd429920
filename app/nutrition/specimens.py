"""Compute a food's density and spread from weighed and measured specimens.

Used for a study's own measurements and for those of ECUSTFD (tools/ecustfd.py).
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Specimen:
    """One measured piece of food. Raises ValueError unless volume and mass are positive and finite."""

    name: str
    volume_ml: float
    mass_g: float

    def __post_init__(self) -> None:
        if not (0.0 < self.volume_ml < math.inf and 0.0 < self.mass_g < math.inf):
            raise ValueError(f"invalid specimen: {self.mass_g} g in {self.volume_ml} ml")

    @property
    def g_per_ml(self) -> float:
        """Return the density."""
        return self.mass_g / self.volume_ml


def median_density(specimens: Sequence[Specimen], *, volume_step_ml: float) -> tuple[float, float]:
    """Return (median density, standard deviation of another specimen from it), g/ml.

    The spread is the specimens' standard deviation, but at least the error of rounding their volumes to steps of
    volume_step_ml (uniform, step / sqrt(12) of the mean volume). Raises ValueError if there are fewer than two.
    """
    if len(specimens) < 2:
        raise ValueError(f"{len(specimens)} specimens; a spread needs two")
    densities = [specimen.g_per_ml for specimen in specimens]
    g_per_ml = statistics.median(densities)
    rounding = (
        volume_step_ml
        / math.sqrt(12.0)
        / statistics.fmean(specimen.volume_ml for specimen in specimens)
    )
    return g_per_ml, max(statistics.stdev(densities), rounding * g_per_ml)
