"""The overview in a browser: charts drawn and read out by keys, a map that moves."""

import re
from datetime import date, timedelta

import pytest
from playwright.sync_api import expect

from tests.e2e.dashboard_server import PASSWORD
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.support.waiting import wait_until

FIRST = date(2026, 11, 1)
PATH = f"/dashboard/studies/overview?from={FIRST}&to={FIRST + timedelta(days=5)}"
PLACES = ((-17.7, 178.0), (-14.3, -170.7), (-18.1, 179.9))  # Fiji and Samoa: neighbours across the 180th meridian


@pytest.fixture(scope="module")
def study(served):
    """Six days of a participant: a day more a meal less, three whole, three places."""
    served.make_study("overview", location_policy="keep")
    served.make_staff("oda", overview="viewer")
    places = [{"latitude": latitude, "longitude": longitude} for latitude, longitude in PLACES]
    with served.enrol("P001", "overview") as phone:
        for number in range(6):
            day = FIRST + timedelta(days=number)
            for hour in range(6, 12 - number):
                item = eaten_item(100.0, energy_kcal=500.0 + number)
                place = places.pop(0) if places else None
                add_meal(served, "P001", day, item, study="overview", hour=hour, place=place)
            if number < 3:
                answer = phone.put(f"/v1/me/days/{day}", json={"status": "closed"}, headers={"If-Match": "*"})
                assert answer.status_code == 200


@pytest.fixture
def opened(served, study, open_page):
    """The overview, once its charts are drawn."""

    def opened(**options):
        tab = open_page(served.address, **options)
        tab.sign_in("oda", PASSWORD, PATH)
        tab.page.wait_for_selector("figure[data-chart=nutrient].is-drawn canvas")
        tab.page.click("summary:text('Map of places')")
        tab.page.wait_for_selector("figure[data-map].is-drawn canvas")
        expect(tab.page.locator("figure[data-chart]:not(.is-drawn)")).to_have_count(0)
        return tab

    return opened


def expect_start(locator, text):
    """Expect a text that begins so, with spaces of the same kind."""
    expect(locator).to_have_text(re.compile("^" + re.escape(text)), use_inner_text=True)


def expect_exactly(locator, text):
    """Expect this text, with spaces of the same kind."""
    expect(locator).to_have_text(re.compile("^" + re.escape(text) + "$"), use_inner_text=True)


def colours(page, figure):
    """How many pixels of a figure's canvas have which colour."""
    return page.eval_on_selector(
        f"{figure} canvas",
        """(canvas) => {
          const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
          const found = {};
          for (let n = 0; n < data.length; n += 4) {
            if (data[n + 3] < 255) continue;
            const key = [data[n], data[n + 1], data[n + 2]].join(" ");
            found[key] = (found[key] ?? 0) + 1;
          }
          return found;
        }""",
    )


def test_chart_is_drawn_and_read_out_by_keys(opened):
    page = opened().page
    wait_until(
        lambda: colours(page, "figure[data-chart=meals]").get("26 102 83", 0) > 5000, "bars in the token's colour"
    )
    told = page.locator("figure[data-chart=energy] output")
    page.focus("figure[data-chart=energy] .plot")
    page.keyboard.press("Home")
    expect_exactly(told, "2026-11-01: whole days 3\u202f000 kcal (n = 1), open days, at least not known")
    page.keyboard.press("ArrowRight")
    expect_start(told, "2026-11-02: whole days 2\u202f505 kcal")
    page.keyboard.press("End")
    expect_exactly(told, "2026-11-06: whole days not known, open days, at least 505 kcal (n = 1)")
    expect(told).to_have_attribute("aria-live", "polite")
    page.keyboard.press("Escape")
    expect(told).to_be_empty()
    page.focus("figure[data-chart=nutrient] .plot")
    page.keyboard.press("End")
    expect(page.locator("figure[data-chart=nutrient] output")).to_contain_text(": days 1")


def test_map_shows_neighbours_across_the_180th_meridian_and_moves_by_keys(opened):
    page = opened().page
    told = page.locator("figure[data-map] output")
    page.focus(".map-place")
    page.keyboard.press("0")
    expect_start(told, "3 of 3 places seen, around 16°S")
    expect(told).to_have_text(re.compile("°[WE]"))
    for _ in range(6):
        page.keyboard.press("+")
    expect_start(told, "0 of 3 places seen")
    page.click("button[data-map-do=fit]")
    expect_start(told, "3 of 3 places seen")
    assert page.locator("table[data-of=places] tbody tr").count() == 3
