"""Choose the density that turns an item's volume into grams, and explain why the others were rejected.

Order of preference: the study's own measurement; a measurement of this food; a row of the
FAO/INFOODS table; a volume portion (cup, cubic inch) of this food; one of a close relative; an
estimate from the food's composition; the food group's median with a wide spread. The kind comes
first: a camera sees the volume including the air in it, so a heap takes a bulk density and a whole
piece a solid one. A cup of sliced apple (0.5 g/ml) says nothing about an apple (0.79).
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from types import MappingProxyType

from app.nutrition.foods import DENSITY_BASES, Density, DensityKind, Food, FoodForm

KIND_OF_FORM: MappingProxyType[FoodForm, DensityKind] = MappingProxyType(
    {
        "whole": "solid",
        "lying": "solid",
        "slab": "solid",
        "heap": "bulk",
        "liquid": "solid",
        "in_vessel": "bulk",
    }
)

# A density of the wrong kind, used if there is no other, may be off by the air in a heap: randomly
# poured spheres fill 0.55 to 0.64 of the space, flakes far less.
WRONG_KIND_RELATIVE_SD = 0.4

_BASIS_TEXT = MappingProxyType(
    {
        "study": "measured by this study",
        "measured": "measured for this food",
        "fao": "from the FAO/INFOODS density table",
        "portion": "from a volume portion of this food",
        "related": "from a close relative of this food",
        "composition": "estimated from what it is made of",
        "group": "the median of its food group",
    }
)


@dataclass(frozen=True, slots=True)
class RejectedDensity:
    """A density that was not chosen, and the reason as a phrase."""

    density: Density
    reason: str


@dataclass(frozen=True, slots=True)
class DensityChoice:
    """The density for one item, the others in order of preference, and the reason as a phrase."""

    chosen: Density
    alternatives: tuple[RejectedDensity, ...]
    reason: str


def resolve_density(
    food: Food, *, form: FoodForm | None = None, study_densities: Iterable[Density] = ()
) -> DensityChoice | None:
    """Return the density for an item of this food in this form (None: the food's usual form).

    study_densities: the study's own measurements of this food, the newest first; they take
    precedence. None if the food has no density: its volume then gives no grams.
    """
    form = form or food.form
    kind = KIND_OF_FORM[form]
    own = [replace(density, basis="study") for density in study_densities]
    # sorted() is stable: within one basis it keeps the table's order, which has the usual state
    # first.
    by_preference = sorted(
        [*own, *food.densities], key=lambda density: DENSITY_BASES.index(density.basis)
    )
    if not by_preference:
        return None
    chosen = next((density for density in by_preference if density.kind == kind), None)
    if chosen is not None:
        reason = f"{_BASIS_TEXT[chosen.basis]}; {kind}, as for {_form_text(form)}"
        others = [density for density in by_preference if density is not chosen]
        return DensityChoice(
            chosen, tuple(RejectedDensity(d, _why_not(d, kind, form)) for d in others), reason
        )
    best = by_preference[0]
    widened = replace(
        best, sd_g_per_ml=max(best.sd_g_per_ml, WRONG_KIND_RELATIVE_SD * best.g_per_ml)
    )
    reason = f"{_BASIS_TEXT[best.basis]}; no {kind} density is known, so a {best.kind} one with a wide spread"
    return DensityChoice(
        widened,
        tuple(RejectedDensity(d, _why_not(d, kind, form)) for d in by_preference[1:]),
        reason,
    )


def _why_not(density: Density, kind: DensityKind, form: FoodForm) -> str:
    if density.kind != kind:
        return f"{density.kind}, but {_form_text(form)} takes a {kind} density"
    return f"{_BASIS_TEXT[density.basis]}: a better one, or one of the usual state, is known"


def _form_text(form: FoodForm) -> str:
    return {
        "whole": "a whole piece",
        "lying": "a lying piece",
        "slab": "a slab",
        "heap": "a heap",
        "liquid": "a liquid",
        "in_vessel": "a food in a vessel",
    }[form]
