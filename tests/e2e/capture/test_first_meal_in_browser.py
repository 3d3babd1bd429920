"""A participant's first meal on the capture page: photographed, sent, corrected; and what a reload keeps."""

import gzip
import re

import pytest
from playwright.sync_api import expect

from tests.e2e.capture.capture_page import enrolled, first_photograph, open_estimated, photograph, send
from tests.e2e.dashboard_server import require

RED = """() => {  // what is shown in the colour of a fault
  const probe = document.createElement("i");
  probe.style.color = "var(--bad)";
  document.body.append(probe);
  const { color } = getComputedStyle(probe);
  const shown = [...document.querySelectorAll("main *")].filter((element) => element.innerText);
  return shown.filter((element) => getComputedStyle(element).color === color).map((element) => element.outerHTML);
}"""


def test_food_and_portion_are_corrected_and_what_was_missing_is_added(served, open_phone):
    tab = open_phone()
    tab.expect("status of 422")  # an amount that can hardly be
    page = enrolled(served, tab)
    photograph(page)
    page.fill("#note", "with my sister")
    meal = send(page)
    open_estimated(served, page, meal)
    page.get_by_text("Your note: with my sister").wait_for()
    page.get_by_text("Correct it").click()
    page.get_by_label("Search for another food").first.fill("pear")
    page.locator(".search .choices button").first.click()
    page.wait_for_selector("li[data-status=corrected]")
    page.get_by_text("Correct it").click()
    page.once("dialog", lambda dialog: dialog.dismiss())
    page.get_by_label("Grams on the plate", exact=True).fill("4500")
    with page.expect_event("dialog"):
        page.get_by_role("button", name="Set the amount").click()
    page.get_by_label("Grams on the plate", exact=True).fill("120")
    page.get_by_role("button", name="Set the amount").click()
    page.get_by_text("120 g").wait_for()
    page.get_by_text("Something is missing").click()
    page.locator(".actions").get_by_label("Search for another food").fill("honey")
    page.locator(".actions .search .choices button").first.click()
    page.wait_for_selector(".items > li:nth-child(2)")
    items = served.meal(meal)["items"]
    assert [item["food"]["key"] for item in items] == ["pear", "honey"]
    assert items[0]["mass_g"] == 120
    events = require(served.admin.get(f"/v1/meals/{meal}/events"))["items"]
    assert [event["new"]["text"] for event in events if event["kind"] == "comment"] == ["with my sister"]


@pytest.mark.slow
def test_reload_between_the_photographs_and_one_without_a_network_lose_nothing(served, open_phone):
    tab = open_phone()
    tab.expect("ERR_INTERNET_DISCONNECTED")
    page = enrolled(served, tab)
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    page.get_by_role("button", name="Photograph a meal").click()
    first_photograph(page)
    draft = page.url
    assert "#take/" in draft
    page.reload()
    page.get_by_role("heading", name="Second photograph").wait_for()
    page.goto(served.address + "/capture/")
    page.click("li[data-state=draft] a")
    page.get_by_role("heading", name="Second photograph").wait_for()
    page.context.set_offline(True)
    page.get_by_role("button", name="Send with one photograph").click()
    page.wait_for_selector("li[data-state=waiting] .offline")
    page.reload()  # by the service worker
    page.wait_for_selector("li[data-state=waiting] .offline")
    page.get_by_text("There is no network.").wait_for()
    assert page.evaluate(RED) == []
    page.context.set_offline(False)
    page.get_by_role("button", name="Try again now").click()
    page.wait_for_selector("li[data-state=sent]")
    meal = served.meal(page.get_attribute("li[data-state=sent]", "data-meal"))
    assert (list(meal["images"]), meal["missing"]) == (["left"], [])
    page.goto(draft)  # it is no draft any more
    page.get_by_role("button", name="Photograph a meal").wait_for()
    expect(page.locator("li[data-state=sent]")).to_have_count(1)


def test_first_view_is_small(served, open_phone):
    """Compressed, as a proxy would: what is loaded before anything is tapped."""
    tab = open_phone()
    loaded = []
    tab.page.on("response", lambda response: loaded.append(response) if response.ok else None)
    tab.goto("/capture/")
    tab.page.get_by_role("button", name="Scan the card").wait_for()
    of_the_page = [response for response in loaded if response.request.frame == tab.page.main_frame]
    assert sum(len(gzip.compress(response.body())) for response in of_the_page) < 150_000
    assert not [response.url for response in of_the_page if re.search("vendor", response.url)]
