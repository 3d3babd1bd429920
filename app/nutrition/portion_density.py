"""Densities from household volumes and from weighed specimens.

A household measure, such as "1 cup, sliced" of 109 g, counts only for the kind that its text
states: mashed, pureed and melted food and the cubic inch give the density of the food itself,
chopped and sliced food that of a heap. Portion weights are of edible food, so a heap's density is
of its edible part.

Specimens are a study's own measurements, and those of ECUSTFD (tools/ecustfd.py).
"""

import math
import re
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from app.core.units import Unit
from app.nutrition.density import KIND_OF_FORM
from app.nutrition.foods import Density, DensityBasis, DensityKind, FoodForm, WeighedPart
from app.nutrition.portions import Portion

# No table publishes a spread; these are judgements (docs/food-table.md, "Spread"): liquids differ
# little; two tables' figures for the same cooked, heaped food differ by 2 to 12 %, plus the
# variation in packing between heaps.
_RELATIVE_SD: Mapping[str, float] = {"liquid": 0.02, "solid": 0.08, "bulk": 0.12}
GROUP_RELATIVE_SD = 0.25  # at least
MIN_GROUP_FOODS = 5
# their weights are rounded more coarsely than a cup's
SMALL_UNITS = frozenset({Unit.TABLESPOON, Unit.FLUID_OUNCE})
_ROBUST_SD = 0.7413  # standard deviation of a normal distribution per unit of interquartile range
# freeze-dried chives to honey; beyond, a weight or a measure is misprinted
POSSIBLE_G_PER_ML = (0.012, 1.6)

_SOLID_WORDS = re.compile(r"\b(mashed|pureed|melted)\b", re.IGNORECASE)
_GROUP_WORDS: Mapping[DensityKind, re.Pattern[str]] = {
    "solid": re.compile(r"\b(mashed|pureed|cubic inch)\b", re.IGNORECASE),
    "bulk": re.compile(
        r"\b(chopped|diced|sliced|slices|cubes|chunks|pieces|whole|halves|shredded)\b",
        re.IGNORECASE,
    ),
}
_MEASURE_NOISE = re.compile(
    r'\b(serving|1/2|1|cups?|fl|oz|tbsp|tablespoons?|ml|8|4|NLEA|no ice)\b|[(),."/]'
)


def usual_relative_sd(form: FoodForm, kind: DensityKind) -> float:
    """Return the assumed spread of a density of this kind, as a share of it."""
    return _RELATIVE_SD["liquid" if form == "liquid" else kind]


def portion_densities(
    portions: Sequence[Portion],
    form: FoodForm,
    state: str,
    source: str,
    *,
    usual_portion: str | None = None,
    cup_kind: DensityKind | None = None,
) -> list[Density]:
    """Return one density per kind and state, the usual portion's first; a cup takes precedence over a tablespoon.

    state: the food's usual state, which a plain cup of it has too. source: source of the portions,
    with the id. usual_portion: sequence of the portion whose state is closest to it. cup_kind: kind
    of a plain cup's density if it differs from the form's.
    """
    densities: dict[tuple[DensityKind, str], Density] = {}
    for portion in sorted(
        portions, key=lambda portion: (portion.sequence != usual_portion, _is_small(portion))
    ):
        if portion.density_g_per_ml is None or not is_possible(portion.density_g_per_ml):
            continue
        kind, portion_state = kind_and_state(portion, form, state, cup_kind)
        density = portion_density(
            portion, source, kind, portion_state, "portion", usual_relative_sd(form, kind)
        )
        densities.setdefault((kind, portion_state), density)
    return list(densities.values())


def portion_density(
    portion: Portion,
    source: str,
    kind: DensityKind,
    state: str,
    basis: DensityBasis,
    relative_sd: float,
) -> Density:
    """Return the density of a volume portion. Raises ValueError if its measure is not a volume."""
    volume, g_per_ml = portion.volume, portion.density_g_per_ml
    if volume is None or g_per_ml is None:
        raise ValueError(
            f"{source}, portion {portion.sequence} ({portion.measure}) is not a volume"
        )
    text = f"{source}, portion {portion.sequence}: {volume[0]:g} {volume[1]} ({portion.measure}) {portion.mass_g:g} g"
    return Density(
        round(g_per_ml, 3),
        round(relative_sd * g_per_ml, 4),
        state,
        kind,
        basis,
        text[:300],
        weighed_part(kind),
    )


def group_medians(
    foods: Iterable[tuple[str, Sequence[Portion]]], source: str
) -> Mapping[tuple[str, DensityKind], Density]:
    """Return (group, kind) -> the group's density, with a wide spread.

    foods: (food group, portions) of all foods.

    A food counts once, by its median; a group with fewer than MIN_GROUP_FOODS such foods has no
    density.
    """
    medians: dict[tuple[str, DensityKind], list[float]] = {}
    for group, portions in foods:
        for kind, pattern in _GROUP_WORDS.items():
            food_densities = [
                g_per_ml
                for portion in portions
                if (g_per_ml := portion.density_g_per_ml) is not None
                and is_possible(g_per_ml)
                and pattern.search(portion.measure)
            ]
            if food_densities:
                medians.setdefault((group, kind), []).append(statistics.median(food_densities))
    return {
        (group, kind): group_median(
            densities,
            kind,
            f"{source}, volume portions: median of {len(densities)} foods of the group {group}",
        )
        for (group, kind), densities in medians.items()
        if len(densities) >= MIN_GROUP_FOODS
    }


def group_median(densities: Sequence[float], kind: DensityKind, source: str) -> Density:
    """Return the median of at least two foods' densities, g/ml, with a spread of at least GROUP_RELATIVE_SD."""
    lower, median, upper = statistics.quantiles(densities, n=4)
    sd = max(GROUP_RELATIVE_SD * median, _ROBUST_SD * (upper - lower))
    return Density(
        round(median, 3), round(sd, 3), "any", kind, "group", source[:300], weighed_part(kind)
    )


def kind_and_state(
    portion: Portion, form: FoodForm, state: str, cup_kind: DensityKind | None = None
) -> tuple[DensityKind, str]:
    """Return kind and state by a volume portion's text: mashed is solid, chopped a heap, a plain cup as usual."""
    if portion.volume is not None and portion.volume[1] == Unit.CUBIC_INCH:
        return "solid", state
    pressed = _SOLID_WORDS.search(portion.measure)
    if pressed:
        return "solid", pressed[1].lower()
    preparation = " ".join(_MEASURE_NOISE.sub(" ", portion.measure).split())
    if preparation:
        return "bulk", preparation[:32]
    usual = KIND_OF_FORM[form] if form in {"liquid", "heap", "in_vessel"} else "bulk"
    return cup_kind or usual, state


def weighed_part(kind: DensityKind) -> WeighedPart:
    """Return the mass that a portion's density refers to: a heap's edible part, or the food itself if pressed."""
    return "edible" if kind == "bulk" else "as_seen"


def is_possible(g_per_ml: float) -> bool:
    """Return whether a household measure can have this density; measured ones have wider limits (plausible.py)."""
    return POSSIBLE_G_PER_ML[0] <= g_per_ml <= POSSIBLE_G_PER_ML[1]


def _is_small(portion: Portion) -> bool:
    return portion.volume is not None and portion.volume[1] in SMALL_UNITS


@dataclass(frozen=True, slots=True)
class Specimen:
    """One measured piece of food.

    Raises ValueError unless volume and mass are positive and finite.
    """

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

    The spread is the specimens' standard deviation, but at least the error of rounding their
    volumes to steps of volume_step_ml (uniform, step / sqrt(12) of the mean volume). Raises
    ValueError if there are fewer than two.
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
