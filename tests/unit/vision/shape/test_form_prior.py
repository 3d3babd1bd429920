import pytest

from app.vision.model import Hint
from app.vision.shape.form_prior import PERSON_ODDS, TABLE_ODDS, form_prior


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
