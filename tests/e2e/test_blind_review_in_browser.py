"""Blind review by keyboard and how far the reviewers agree, in a real browser: wide, narrow, without a violation."""

import re
import uuid

import pytest
import sqlalchemy as sa
from playwright.sync_api import expect

from app.meals.stored.decision_models import ReviewDecision
from app.meals.stored.models import Meal
from app.people.models import Staff
from tests.e2e.browser import require_legible
from tests.e2e.dashboard_server import PASSWORD
from tests.support.estimates import identified_item
from tests.support.two_reviewers import made_study

RING = [[150.0, 100.0], [420.0, 110.0], [400.0, 350.0], [170.0, 330.0]]
PROTOCOL = {"seed": 7, "share": 1, "limit_percent": 20}

pytestmark = pytest.mark.slow


@pytest.fixture
def study_of(served):
    """A study of its own, with reviewers and a meal a number of grams."""

    def study_of(code, meals=4):
        served.make_study(code, double_review=PROTOCOL)
        for name, role in (("ann", "reviewer"), ("bob", "reviewer"), ("cid", "owner")):
            served.make_staff(f"{name}-{code}", **{code: role})
        with served.enrol("P001", code) as phone:
            for number in range(meals):
                item = identified_item({"apple": 0.5, "pear": 0.3}, volume_ml=100.0 + number, polygon=RING, hint=0)
                hints = [{"point": [300, 200], "food": "apple"}]
                served.send_meal(phone, item, hints=hints, captured_at=f"2026-11-20T12:3{number}:00+08:00")
        return f"/dashboard/studies/{code}"

    return study_of


def item(page):
    return page.locator("input[name=item]").get_attribute("value")


def press(page, *keys):
    """Keys, the last of which brings another page."""
    for key in keys[:-1]:
        page.keyboard.press(key)
    with page.expect_navigation():
        page.keyboard.press(keys[-1])


def test_items_are_decided_by_keys_and_a_third_settles_them(served, open_page, study_of):
    study = study_of("blind")
    tab = open_page(served.address)
    tab.sign_in("ann-blind", PASSWORD, f"{study}/blind")
    page = tab.page
    first = item(page)
    expect(page.locator(".review-crop image")).to_have_attribute("href", re.compile("picture"))
    require_legible(page, "item")
    press(page, "2", "Enter")
    require_legible(page, "decided")
    second = item(page)
    press(page, "u")
    assert item(page) == first
    page.keyboard.press("m")
    page.keyboard.type("80,5")
    tab.expect("422")
    press(page, "Enter")  # no food was chosen
    expect(page.get_by_role("alert").filter(has_text="ood and grams")).to_be_visible()
    require_legible(page, "refused")
    page.keyboard.press("f")
    page.keyboard.type("pear")
    page.locator("#blind-foods [role=option]").first.wait_for()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.keyboard.press("Escape")
    press(page, "y")
    assert item(page) == second
    press(page, "x")
    third = item(page)
    press(page, "s")
    assert item(page) != third
    press(page, "1", "Enter")
    page.get_by_role("link", name="Show those that were skipped").click()
    assert item(page) == third

    tab = open_page(served.address)
    tab.sign_in("bob-blind", PASSWORD, f"{study}/blind")
    page = tab.page
    assert item(page) == first
    assert "80.5" not in page.content()
    for _ in range(2):
        press(page, "1", "Enter")

    tab = open_page(served.address)
    tab.sign_in("cid-blind", PASSWORD, f"{study}/blind")
    page = tab.page
    page.select_option("#differing", "true")
    with page.expect_navigation():
        page.get_by_role("button", name="Show").click()
    expect(page.get_by_text("What two reviewers decided")).to_be_visible()
    assert item(page) == first
    require_legible(page, "settle")
    press(page, "1", "Enter")
    assert item(page) == second


def test_agreement_is_legible(served, open_page, study_of):
    study = study_of("agreeing", meals=1)
    with served.database.write() as session:
        staff = dict(session.execute(sa.select(Staff.name, Staff.id)).all())
        meal = session.scalars(sa.select(Meal).order_by(Meal.received_at.desc())).first()
        for number, dish in enumerate(made_study()):
            for name, (food, grams) in zip(("ann", "bob"), dish, strict=True):
                session.add(
                    ReviewDecision(
                        id=uuid.uuid4(),
                        study_id=meal.study_id,
                        meal_id=meal.id,
                        item_id=uuid.UUID(int=number),
                        staff_id=staff[f"{name}-agreeing"],
                        is_final=False,
                        food_key=food,
                        mass_g=grams,
                        energy_kcal=1.4 * grams,
                        decided_at=meal.received_at,
                    )
                )
    tab = open_page(served.address)
    tab.sign_in("cid-agreeing", PASSWORD, f"{study}/agreement")
    expect(tab.page.locator(".bland-altman")).to_have_count(2)
    require_legible(tab.page, "agreement")
