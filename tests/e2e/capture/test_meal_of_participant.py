"""A meal's page on the phone: one that failed, what was eaten of it, what was said offline, and its note."""

import pytest
import sqlalchemy as sa
from playwright.sync_api import expect

from app.meals.stored.record_models import EffectiveRecord
from tests.e2e.browser import WIDER
from tests.e2e.capture.capture_page import open_estimated, sent_meal
from tests.support import estimates
from tests.support.estimates import identified_item
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

UNSENT = """async () => {
  const store = await import("/capture/store.js");
  return (await store.meals()).filter((record) => record.state !== "sent").length;
}"""
FAILURE = {"code": "marker_not_found", "message": "No board.", "advice": "Put it beside the plate."}


def test_failed_meal_is_photographed_again_or_entered(served, open_phone):
    tab = open_phone()
    page, meal = tab.page, sent_meal(served, tab)
    estimates.save(served, meal, failure=FAILURE)
    page.click(f"li[data-meal='{meal}'] a")
    page.get_by_role("button", name="Photograph it again").click()
    page.get_by_role("heading", name="First photograph").wait_for()
    page.go_back()
    page.get_by_text("Enter what you ate").wait_for()
    page.get_by_label("Search for another food").fill("honey")
    page.locator(".actions .search .choices button").first.click()
    page.wait_for_selector(".items > li:nth-child(1)")
    assert [item["food"]["key"] for item in served.meal(meal)["items"]] == ["honey"]


@pytest.mark.parametrize("offline", [False, True])
def test_all_eaten_is_acknowledged_and_taken_back(served, open_phone, offline):
    tab = open_phone(service_workers="block")  # it would send what waits
    tab.expect("Service Worker registration blocked|ERR_INTERNET_DISCONNECTED")
    page, meal = tab.page, sent_meal(served, tab)
    open_estimated(served, page, meal)
    page.get_by_role("button", name="I ate all of it").wait_for()
    page.context.set_offline(offline)
    page.get_by_role("button", name="I ate all of it").click()
    page.get_by_text("✓ I ate all of it").wait_for()
    if not offline:
        expect(page.get_by_text("Waiting to be sent")).to_have_count(0)
        assert served.meal(meal)["after"]["status"] == "nothing_left"
    page.get_by_role("button", name="Take it back").click()
    page.get_by_role("button", name="I ate all of it").wait_for()
    expect(page.get_by_text("✓ I ate all of it")).to_have_count(0)
    assert served.meal(meal)["after"]["status"] != "nothing_left"


@pytest.mark.parametrize(("has_changed", "status"), [(False, "confirmed"), (True, "estimated")])
def test_confirmation_without_a_network_is_sent_later_for_the_meal_that_was_seen(
    served, open_phone, has_changed, status
):
    tab = open_phone()
    tab.expect("status of 412|ERR_INTERNET_DISCONNECTED")
    page, meal = tab.page, sent_meal(served, tab)
    open_estimated(served, page, meal)
    page.get_by_role("button", name="That is right").wait_for()
    page.context.set_offline(True)
    page.get_by_role("button", name="That is right").click()
    page.get_by_text("✓ That is right · Waiting to be sent").wait_for()
    expect(page.get_by_role("button", name="All of it is right")).to_have_count(0)
    if has_changed:
        served.say(meal, "comment", text="Looks good.")
    page.get_by_role("link", name="Meals").click()
    page.wait_for_selector(f"li[data-meal='{meal}/review'][data-state=waiting]")
    page.context.set_offline(False)
    wait_until(lambda: page.evaluate(UNSENT) == 0, "the confirmation to leave the phone")
    assert served.meal(meal)["status"] == status


def test_half_a_gram_is_not_none_and_an_absurd_bound_is_broken_into_lines(served, open_phone):
    tab = open_phone()
    page, meal = tab.page, sent_meal(served, tab)
    estimates.save(served, meal, identified_item({"apple": 0.9}))
    with served.database.write() as session:
        session.execute(sa.update(EffectiveRecord).values(mass_g=5.04, mass_low_g=0.5, mass_high_g=1e60))
    page.click(f"li[data-meal='{meal}'] a")
    expect(page.get_by_text("5 g (probably 0.5 to 1,000,000")).to_be_visible()
    assert page.evaluate(WIDER) == []
