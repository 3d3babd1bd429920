import pytest

from app.vision.model import Hint, LikelyFood
from app.vision.solids.form_prior import PERSON_ODDS, TABLE_ODDS, LikelyForms, form_prior
from app.vision.solids.single_starts import USUAL_HEIGHTS
from app.vision.tuning import SINGLE_TUNING


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
    nothing, whole, half = (LikelyForms(foods) for foods in ([], [LikelyFood("whole", 1.0)], [LikelyFood("slab", 0.5)]))
    assert {nothing.factor(family) for family in ("ball", "lying", "slab", "block", "heap")} == {1 / 3}
    assert whole.factor("ball") == whole.factor("bent") == pytest.approx(0.95)
    assert whole.factor("heap") == whole.factor("wedge") == pytest.approx(0.025)
    assert half.factor("slab") == pytest.approx(0.5 / 3 + 0.5 * 0.95)
    assert sum(half.factor(family) for family in ("ball", "slab", "heap")) == pytest.approx(1.0)


def test_candidates_heights_mix_with_the_usual_one_by_their_probability_and_widen_it_where_they_differ():
    heights = [
        LikelyForms([LikelyFood("slab", p, 0.1), LikelyFood("slab", 1 - p)]).heights(USUAL_HEIGHTS)
        for p in (0.0, 0.5, 1.0)
    ]
    usual, between, known = (each["slab"] for each in heights)
    assert usual == pytest.approx(USUAL_HEIGHTS["slab"])
    assert known == pytest.approx((0.1, SINGLE_TUNING.food_height_sd))
    assert between[0] == pytest.approx((0.1 * usual[0]) ** 0.5)
    assert between[1] > usual[1] > known[1]
    assert heights[0]["ball"] == USUAL_HEIGHTS["ball"]


def test_what_lies_is_as_high_as_wide_unless_its_candidates_say_otherwise():
    doubted, sure = (LikelyForms([LikelyFood("lying", p, 0.5)]).heights(USUAL_HEIGHTS) for p in (0.2, 1.0))
    assert "lying" not in doubted
    assert sure["lying"][0] == pytest.approx(0.5)
    assert sure["ball"] == USUAL_HEIGHTS["ball"]
