import pytest

from app.vision.model import Hint
from app.vision.solids.form_prior import PERSON_ODDS, TABLE_ODDS, LikelyForms, form_prior


def test_persons_form_goes_before_lies_as_and_both_before_the_usual_form():
    assert form_prior(Hint(form="slab", lies_as="heap", usual_form="whole")).families == {"slab", "block", "wedge"}
    assert form_prior(Hint(lies_as="heap", usual_form="whole")).families == {"heap"}
    assert "ball" in form_prior(Hint(usual_form="whole")).families


def test_persons_word_counts_more_than_the_food_table():
    said, usual = form_prior(Hint(form="slab")), form_prior(Hint(usual_form="slab"))
    assert said.factor("block") == usual.factor("block") == 1.0
    assert said.factor("ball") == 1 / PERSON_ODDS < usual.factor("ball") == 1 / TABLE_ODDS


@pytest.mark.parametrize("hint", [None, Hint(), Hint(form="liquid"), Hint(usual_form="in_vessel")])
def test_hint_without_a_form_of_these_families_has_no_prior(hint):
    assert form_prior(hint) is None


def test_persons_form_is_unlikely_where_another_forms_family_wins_by_more_than_the_odds():
    prior = form_prior(Hint(form="slab"))
    assert prior.is_unlikely({"ball": 0.0, "slab": -5.0})
    assert not prior.is_unlikely({"ball": 0.0, "slab": -4.0})
    assert not prior.is_unlikely({"slab": 0.0, "ball": -9.0})
    assert prior.is_unlikely({"ball": 0.0})  # none of its families fits at all
    assert not form_prior(Hint(usual_form="slab")).is_unlikely({"ball": 0.0})  # the food table's form never is


def test_candidates_favour_their_forms_by_the_food_tables_odds_and_share_what_is_not_known():
    nothing, whole, half = LikelyForms({}), LikelyForms({"whole": 1.0}), LikelyForms({"slab": 0.5})
    assert {nothing.factor(family) for family in ("ball", "lying", "slab", "block", "heap")} == {1 / 3}
    assert whole.factor("ball") == whole.factor("bent") == pytest.approx(0.95)
    assert whole.factor("heap") == whole.factor("wedge") == pytest.approx(0.025)
    assert half.factor("slab") == pytest.approx(0.5 / 3 + 0.5 * 0.95)
    assert sum(half.factor(family) for family in ("ball", "slab", "heap")) == pytest.approx(1.0)
