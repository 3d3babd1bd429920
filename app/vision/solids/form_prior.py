"""What is known of a food's form beforehand, as odds of the families: a person's word strongly, a food table weakly.

A hint, or the foods that one photograph may show -> the factor of each family's weight, and whether the picture speaks
against what a person said.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np

from app.vision.looks.vcm import describe_rings
from app.vision.model import (
    ColourCorrection,
    EstimateOptions,
    Float32Array,
    FoodForm,
    Hint,
    Photo,
)
from app.vision.scene.segmentation import Foods
from app.vision.solids.outlines import rings_of

# A food that lies is also called whole. What a liquid or a vessel's content looks like says nothing of these families.
FAMILIES_OF_FORM: Mapping[FoodForm, frozenset[str]] = {
    "whole": frozenset({"ball", "lying", "bent", "ring"}),
    "lying": frozenset({"lying", "bent"}),
    "slab": frozenset({"slab", "block", "wedge"}),
    "heap": frozenset({"heap"}),
}
FORMS: tuple[FoodForm, ...] = ("whole", "slab", "heap")  # between which one outline hardly decides
PERSON_ODDS = 100.0  # that a person who says how a food lies means one of that form's families
TABLE_ODDS = 4.0  # that a food lies as its kind usually does: an apple is eaten whole more often than in slices
SINGLE_TABLE_ODDS = 20.0  # the same where one outline, which hardly tells forms apart, is all that speaks against it


@dataclass(frozen=True, slots=True)
class FormPrior:
    """families: those of the form; odds: by which they are likelier than others. is_said: by a person."""

    families: frozenset[str]
    odds: float
    is_said: bool

    def factor(self, family: str) -> float:
        """Of a family's weight, 1 for those of the form."""
        return 1.0 if family in self.families else 1.0 / self.odds

    def share(self, family: str) -> float:
        """The same of a single view, where the other forms share those odds."""
        others = sum(
            1
            for form, families in FAMILIES_OF_FORM.items()
            if form != "lying" and self.families != families
        )
        odds = self.odds if self.is_said else SINGLE_TABLE_ODDS
        return 1.0 if family in self.families else 1.0 / (odds * max(others, 1))

    def is_unlikely(self, log_evidence: Mapping[str, float]) -> bool:
        """Whether the picture outweighs a person's word. log_evidence: of the families that were fitted, by name."""
        if not self.is_said or not log_evidence:
            return False
        of_form = [value for name, value in log_evidence.items() if name in self.families]
        return not of_form or max(log_evidence.values()) - max(of_form) > float(np.log(self.odds))


@dataclass(frozen=True, slots=True)
class LikelyForms:
    """probabilities: of the forms that a food's candidates usually have, 0 to 1; their sum may be less than 1."""

    probabilities: Mapping[str, float]

    def factor(self, family: str) -> float:
        """Return the factor of a family's weight.

        It sums the probability of the family's own form, a small share of the other forms' probability, and a third of
        what no candidate accounts for.
        """
        of_family = sum(
            self.probabilities.get(form, 0.0) for form in FORMS if family in FAMILIES_OF_FORM[form]
        )
        candidates = sum(self.probabilities.get(form, 0.0) for form in FORMS)
        unknown, other_forms = max(1.0 - candidates, 0.0), len(FORMS) - 1
        of_others = (candidates - of_family) / (SINGLE_TABLE_ODDS * other_forms)
        return of_family * (1.0 - 1.0 / SINGLE_TABLE_ODDS) + of_others + unknown / len(FORMS)


def form_prior(hint: Hint | None) -> FormPrior | None:
    """The prior of a hint; None where it says nothing of the families."""
    if hint is None:
        return None
    stated_form = hint.form or cast("FoodForm | None", hint.lies_as)
    form = stated_form or hint.usual_form
    if form is None or form not in FAMILIES_OF_FORM:
        return None
    return FormPrior(
        FAMILIES_OF_FORM[form], PERSON_ODDS if stated_form else TABLE_ODDS, stated_form is not None
    )


def likely_forms(
    foods: Foods,
    photo: Photo,
    places: Float32Array,
    colour: ColourCorrection,
    options: EstimateOptions,
) -> list[LikelyForms | None]:
    """The forms that each region may have by its looks in a single view, where its outline hardly tells.

    None where a hint tells, or nothing can be described. places: (H, W, 2) px, see outlines.photograph_px.
    """
    if options.forms_by_looks is None:
        return []
    likely: list[LikelyForms | None] = []
    for region in foods.regions:
        vector = None
        hint = options.hints[region.hint] if region.hint is not None else None
        if form_prior(hint) is None:
            rings = rings_of(region.mask, places, is_swapped=False)
            vector = describe_rings(photo.pixels_bgr, rings, colour)
        if vector is None:
            likely.append(None)
        else:
            likely.append(LikelyForms(options.forms_by_looks(vector.astype(np.float64))))
    return likely
