"""A food that is taught, and a group with reasons in review, in a real browser: wide, narrow, without a violation."""

import re

import cv2
import numpy as np
import pytest

from app.identification.food_index import shipped_index
from tests.e2e.browser import violations
from tests.e2e.dashboard_server import PASSWORD
from tests.support.estimates import identified_item, vcm
from tests.support.looks import vectors_of

KEY = "soup-tomato"  # which the index does not know
REASONS = ["eaten_before", "eaten_with", "usual_in_study", "size_fits"]
RING = [[150.0, 100.0], [420.0, 110.0], [400.0, 350.0], [170.0, 330.0]]

pytestmark = pytest.mark.slow


def stripes(seed):
    pixels = np.random.default_rng(seed).normal(120, 6, (600, 600, 3)).clip(0, 255).astype(np.uint8)
    cv2.circle(pixels, (300, 300), 240, (200, 60, 30), -1)
    for place in range(100, 500, 60 + seed):
        cv2.line(pixels, (120, place), (480, place), (20, 220, 240), 16)
    return cv2.imencode(".jpg", pixels)[1].tobytes()


def study_of(served, code, item):
    """The address of a study with one item, and with an owner."""
    served.make_study(code)
    served.make_staff(f"olga-{code}", **{code: "owner"})
    with served.enrol("P001", code) as phone:
        served.send_meal(phone, item)
    return f"/dashboard/studies/{code}"


def require_legible(page):
    """Nothing is wrong on the page, wide and narrow."""
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 900})
        assert violations(page) == []


def test_food_is_taught_by_photographs_and_items(served, open_page):
    banana = vcm(*vectors_of(shipped_index(), "banana")[0])
    study = study_of(served, "taught", identified_item({}, none=0.9, vcm=banana, polygon=RING))
    watched = open_page(served.address)
    watched.sign_in("olga-taught", PASSWORD, f"/dashboard/foods/{KEY}")
    page = watched.page
    page.get_by_role("link", name="Pilot study").last.click()
    page.wait_for_url(re.compile(f"{study}/taught-foods/{KEY}$"))
    pictures = [{"name": f"{seed}.jpg", "mimeType": "image/jpeg", "buffer": stripes(seed)} for seed in range(3)]
    page.set_input_files("#photo", pictures)
    page.get_by_role("button", name="Add", exact=True).click()
    page.wait_for_selector("text=3 new photographs are drafts")
    page.locator("input[name=item]").last.check()
    page.get_by_role("button", name="See what they are confused with").click()
    page.wait_for_url(re.compile("item="))
    require_legible(page)
    page.get_by_role("button", name="Put in force").click()
    page.wait_for_selector("text=4 more examples count")
    require_legible(page)
    page.get_by_role("button", name="Take back").first.click()
    page.wait_for_selector("text=The photograph teaches no more")


def test_review_shows_a_group_and_the_reasons_of_candidates(served, open_page):
    doubtful = (("citrus-fruit", 0.71, []), ("orange", 0.4, REASONS), ("lemon", 0.3, ["size_unusual"]))
    candidates = [
        {"food": key, "probability": probability, "specimens": 9, "is_group": not reasons, "reasons": reasons}
        for key, probability, reasons in doubtful
    ]
    study = study_of(served, "grouped", identified_item({}, none=0.1, candidates=candidates, polygon=RING))
    watched = open_page(served.address)
    watched.sign_in("olga-grouped", PASSWORD, f"{study}/review")
    page = watched.page
    card = page.locator(".review-card:not([hidden])")
    group = card.locator(".choice", has_text="Citrus fruit")
    group.wait_for()
    assert "group" in group.inner_text()
    assert "eaten with what lies beside it" in card.inner_text()
    require_legible(page)
    page.goto(served.address + card.get_attribute("data-page"))
    assert "usual in this study" in page.locator(".candidates").inner_text()
    require_legible(page)
