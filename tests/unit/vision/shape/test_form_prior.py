import pytest

from app.vision.model import Hint
from app.vision.shape.form_prior import PERSON_ODDS, TABLE_ODDS, LikelyForms, form_prior


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


def test_form_is_unlikely_where_another_forms_family_wins_by_more_than_the_odds():
    prior = form_prior(Hint(form="slab"))
    assert prior.is_unlikely({"ball": 0.0, "slab": -5.0})
    assert not prior.is_unlikely({"ball": 0.0, "slab": -4.0})
    assert not prior.is_unlikely({"slab": 0.0, "ball": -9.0})


def test_form_is_unlikely_where_none_of_its_families_fits_at_all():
    assert form_prior(Hint(form="slab")).is_unlikely({"ball": 0.0})


def test_food_tables_form_is_never_called_unlikely():
    assert not form_prior(Hint(usual_form="slab")).is_unlikely({"ball": 0.0})


def test_nothing_known_favours_no_form():
    nothing = LikelyForms({})
    assert {nothing.factor(family) for family in ("ball", "lying", "slab", "block", "heap")} == {1 / 3}


def test_certain_candidate_favours_its_form_by_the_food_tables_odds():
    whole = LikelyForms({"whole": 1.0})
    assert whole.factor("ball") == whole.factor("bent") == pytest.approx(0.95)
    assert whole.factor("heap") == whole.factor("wedge") == pytest.approx(0.025)


def test_what_the_index_does_not_know_is_shared_alike():
    half = LikelyForms({"slab": 0.5})
    assert half.factor("slab") == pytest.approx(0.5 / 3 + 0.5 * 0.95)
    assert sum(half.factor(family) for family in ("ball", "slab", "heap")) == pytest.approx(1.0)
