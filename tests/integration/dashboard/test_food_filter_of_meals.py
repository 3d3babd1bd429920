"""The filter of meals by food without scripts: keys are entered, unknown ones are reported."""

from tests.integration.dashboard.conftest import text_of

MEALS = "/dashboard/studies/pilot/meals"


def test_unknown_food_key_is_reported_beside_a_known_one(enrol, sign_in_browser):
    enrol()
    browser = sign_in_browser("ann", pilot="viewer")
    for food, is_told in (("apple", False), ("Apple pie <b>", True), ("", False)):
        page = browser.page(MEALS, food=["banana", food])
        assert ("No food of the tables has the key" in page) == is_told
        assert "“banana”" not in page
    page = browser.page(MEALS, food="apples")
    assert "No food of the tables has the key “apples”" in text_of(page)
