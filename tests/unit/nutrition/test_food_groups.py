"""Recommendations by food group: their ages, known groups and ordered amounts."""

from app.nutrition.intakes.reference_intakes import FOOD_GROUPS, recommendations


def fruit_and_vegetables(age_years=30):
    return next(found for found in recommendations(age_years) if found.name == "Vegetables and fruits")


def test_recommendations_follow_age_and_name_known_groups_and_ordered_amounts():
    assert recommendations(1.9) == ()
    assert [fruit_and_vegetables(age).low_g for age in (2, 5.9, 6, 9.9, 10, 80)] == [250, 250, 350, 350, 400, 400]
    assert {found.source[:3] for found in recommendations(17)} == {"WHO"}
    assert {found.source[:3] for found in recommendations(18)} == {"WHO", "EAT"}
    for found in recommendations(30):
        assert found.groups
        assert set(found.groups) <= set(FOOD_GROUPS)
        amounts = [grams for grams in (found.low_g, found.target_g, found.high_g) if grams is not None]
        assert amounts == sorted(amounts)
