"""What is known of a food's form beforehand, as odds of the families: a person's word strongly, a food table weakly.

A hint, or the foods that one photograph may show -> the factor of each family's weight, and whether the picture speaks
against what a person said.
"""

from collections.abc import Mapping, Sequence
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
    LikelyFood,
    Photo,
)
from app.vision.scene.segmentation import Foods
from app.vision.solids.outlines import rings_of
from app.vision.tuning import SINGLE_TUNING

# of families: over the width, and the spread of the logarithm
Heights = Mapping[str, tuple[float, float]]

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

    def is_unlikely(self, log_evidence: Mapping[str, float]) -> bool:
        """Whether the picture outweighs a person's word. log_evidence: of the families that were fitted, by name."""
        if not self.is_said or not log_evidence:
            return False
        of_form = [value for name, value in log_evidence.items() if name in self.families]
        return not of_form or max(log_evidence.values()) - max(of_form) > float(np.log(self.odds))


@dataclass(frozen=True, slots=True)
class LikelyForms:
    """What a food's candidates say of its form. The sum of their probabilities may be less than 1."""

    foods: Sequence[LikelyFood]

    def factor(self, family: str) -> float:
        """Return the factor of a family's weight.

        It sums the probability of the family's own form, a small share of the other forms' probability, and a third of
        what no candidate accounts for.
        """
        candidates = sum(food.probability for food in self.foods)
        of_family = sum(
            (food.probability for food in self.foods if family in FAMILIES_OF_FORM[food.form]), 0.0
        )
        other_forms = len(FORMS) - 1
        of_others = (candidates - of_family) / (SINGLE_TABLE_ODDS * other_forms)
        return of_family * (1.0 - 1.0 / SINGLE_TABLE_ODDS) + of_others + self._unknown / len(FORMS)

    def heights(self, usual: Heights) -> Heights:
        """Return what the candidates whose heights are known, and the family's usual height for all else, say together.

        A family without a usual one has theirs if they are likelier than all else.
        """
        together: dict[str, tuple[float, float]] = {}
        for family in frozenset().union(*FAMILIES_OF_FORM.values()):
            of_form = [food for food in self.foods if family in FAMILIES_OF_FORM[food.form]]
            parts = [
                (food.probability, float(np.log(food.height)), SINGLE_TUNING.food_height_sd)
                for food in of_form
                if food.height is not None
            ]
            known = sum(probability for probability, _, _ in parts)
            rest = sum(food.probability for food in of_form) - known + self._unknown / len(FORMS)
            if known > (0.0 if family in usual else rest):
                if family in usual:
                    parts.append((rest, float(np.log(usual[family][0])), usual[family][1]))
                together[family] = _moments(parts)
        return {**usual, **together}

    @property
    def _unknown(self) -> float:
        """The probability that it is none of the candidates."""
        return max(1.0 - sum(food.probability for food in self.foods), 0.0)


def _moments(parts: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """Return height and spread of its logarithm of a mixture. parts: weight, logarithm of the height, spread."""
    weight, log_height, sd = np.array(parts).T
    weight = weight / weight.sum()
    mean = float(weight @ log_height)
    return float(np.exp(mean)), float(np.sqrt(weight @ (sd**2 + (log_height - mean) ** 2)))


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
    """The forms that each region may have in a single view, where an outline hardly tells: by its food or its looks.

    None where a person says the form, or nothing can be described. places: (H, W, 2) px, see outlines.photograph_px.
    """
    likely: list[LikelyForms | None] = []
    for region in foods.regions:
        hint = options.hints[region.hint] if region.hint is not None else None
        prior = form_prior(hint)
        seen: Sequence[LikelyFood] | None = None
        if hint is not None and prior is not None and not prior.is_said:
            seen = [LikelyFood(cast("FoodForm", hint.usual_form), 1.0, hint.usual_height)]
        elif prior is None and options.foods_by_looks is not None:
            rings = rings_of(region.mask, places, is_swapped=False)
            vector = describe_rings(photo.pixels_bgr, rings, colour)
            seen = None if vector is None else options.foods_by_looks(vector.astype(np.float64))
        likely.append(None if seen is None else LikelyForms(seen))
    return likely
