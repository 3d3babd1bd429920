"""The overview in a browser: charts drawn and read out by keys, a map that moves; and what they reckon, by itself."""

import re
from datetime import date, timedelta

import pytest
import sqlalchemy as sa
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from app.meals.models import Meal
from tests.e2e.dashboard_server import PASSWORD, dashboard_server
from tests.e2e.static_modules import open_modules
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

FIRST = date(2026, 11, 1)
PATH = f"/dashboard/studies/pilot?from={FIRST}&to={FIRST + timedelta(days=5)}"
PLACES = ((-17.7, 178.0), (-14.3, -170.7), (-18.1, 179.9))  # Fiji and Samoa: neighbours across the 180th meridian


@pytest.fixture(scope="module")
def served(chromium, tmp_path_factory):
    """Six days of a participant: a day more a meal less, three whole, three places."""
    server = dashboard_server(tmp_path_factory.mktemp("overview"))
    server.make_study(location_policy="keep")
    server.make_staff("ann", pilot="viewer")
    with server.enrol() as phone:
        for number in range(6):
            day = FIRST + timedelta(days=number)
            for hour in range(6, 12 - number):
                add_meal(server, "P001", day, eaten_item(100.0, energy_kcal=500.0 + number), hour=hour)
            if number < 3:
                answer = phone.put(f"/v1/me/days/{day}", json={"status": "closed"}, headers={"If-Match": "*"})
                assert answer.status_code == 200
    with server.database.write() as session:
        meals = session.scalars(sa.select(Meal).order_by(Meal.captured_at).limit(len(PLACES)))
        for meal, (latitude, longitude) in zip(meals, PLACES, strict=True):
            meal.details = {"location": {"latitude": latitude, "longitude": longitude}}
    yield server
    server.close()


@pytest.fixture
def opened(served, open_page):
    """The overview, once its charts are drawn."""

    def opened(**options):
        tab = open_page(served.address, **options)
        tab.sign_in("ann", PASSWORD, PATH)
        tab.page.wait_for_selector("figure[data-chart=nutrient].is-drawn canvas")
        tab.page.wait_for_selector("figure[data-map].is-drawn canvas")
        expect(tab.page.locator("figure[data-chart]:not(.is-drawn)")).to_have_count(0)
        return tab

    return opened


@pytest.fixture
def run(open_page):
    """What a script returns that may import the static modules."""
    watched = open_modules(open_page)
    return lambda script: watched.page.evaluate(f"async () => {{ {script} }}")


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


def test_chart_is_drawn_and_read_out_by_keys(served, opened):
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


def test_charts_and_map_follow_light_and_dark(opened):
    tab = opened()
    tab.expect("willReadFrequently")  # this test reads the canvas
    page = tab.page

    def dark_bars():
        return colours(page, "figure[data-chart=meals]").get("127 209 182", 0)

    def light_sea():
        return colours(page, "figure[data-map]").get("236 238 234", 0)

    wait_until(lambda: light_sea() > 1000, "the sea in the light token's colour")
    assert dark_bars() == 0
    page.click("[data-theme-toggle]")
    wait_until(lambda: dark_bars() > 0, "bars in the dark token's colour")
    wait_until(lambda: light_sea() < 1000, "the sea in the dark token's colour")


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


@pytest.mark.parametrize("options", [{}, {"color_scheme": "dark"}, {"viewport": {"width": 390, "height": 800}}])
def test_overview_has_no_finding_of_accessibility(opened, options):
    page = opened(**options).page
    for details in page.locator("main details summary").all():
        details.click()
    found = Axe().run(page).response["violations"]
    assert [(each["id"], each["nodes"][0]["html"]) for each in found] == []
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


def test_overview_tells_all_without_scripts(opened, served, open_page):
    tab = open_page(served.address, java_script_enabled=False)
    tab.sign_in("ann", PASSWORD, PATH)
    assert not tab.page.locator("figure[data-chart=meals]").is_visible()
    tab.page.locator("section[aria-labelledby=meals] summary").click()
    assert "2026-11-06" in tab.page.inner_text("table[data-of=meals]")


def test_view_turns_pixels_into_places_and_back(run):
    off = run("""
      const { MapView } = await import("/map-view.js");
      const view = new MapView([{ latitude: 60.2, longitude: 24.9 }, { latitude: 61.5, longitude: 23.8 }]);
      view.resize(700, 350);
      view.zoom(3, 100, 40);
      view.pan(33, -12);
      const found = [];
      for (const [longitude, latitude] of [[24.9, 60.2], [23.8, 61.5], [30, 50]]) {
        const place = view.placeOf(...view.pixelOf(longitude, latitude));
        found.push(Math.abs(place.longitude - longitude), Math.abs(place.latitude - latitude));
      }
      return Math.max(...found);
    """)
    assert off < 1e-9


def test_place_under_the_pointer_stays_when_the_map_is_zoomed(run):
    before, after = run("""
      const { MapView } = await import("/map-view.js");
      const view = new MapView([{ latitude: 1, longitude: 1 }, { latitude: 30, longitude: 40 }]);
      view.resize(600, 400);
      const before = view.placeOf(450, 90);
      view.zoom(2.5, 450, 90);
      return [before, view.placeOf(450, 90)];
    """)
    assert after == pytest.approx(before)


def test_scale_bar_is_as_long_as_it_says(run):
    # 0.1 degrees of latitude are 11.12 km
    for south in (0.0, 48.0, 70.0):
        bar, north = run(f"""
          const [south, north] = [{south}, {south} + 0.1];
          const {{ MapView }} = await import("/map-view.js");
          const view = new MapView([{{ latitude: south, longitude: 5 }}, {{ latitude: north, longitude: 5.1 }}]);
          view.resize(600, 400);
          return [view.scaleBar(), view.pixelOf(5, south)[1] - view.pixelOf(5, north)[1]];
        """)
        assert bar["pixels"] <= 120
        assert north / bar["pixels"] == pytest.approx(11.1195 / bar["km"], rel=1e-6)


def test_people_on_both_sides_of_the_180th_meridian_are_near(run):
    starts = run("""
      const { westernmost } = await import("/map-view.js");
      return [[178, -170.7, 179.9], [10, 20, 30], [-80, 100], [5], [-179, 179]].map(westernmost);
    """)
    assert starts == [178, 10, -80, 5, 179]


def test_stacked_bars_end_at_the_sum_of_those_below(run):
    tops = run("""
      globalThis.uPlot = {};
      const { stackedTops } = await import("/charts.js");
      return stackedTops([{ values: [1, 2] }, { values: [3, null] }, { values: [5, 7] }]);
    """)
    assert tops == [[1, 2], [4, 2], [9, 9]]


def test_land_is_whole_rings_within_the_globe(run):
    rings = run("""
      const { readLand } = await import("/map.js");
      const rings = readLand(await (await fetch("/vendor/natural-earth/land.json")).json());
      return rings.map((ring) => Array.from(ring));
    """)
    assert len(rings) > 100
    for ring in rings:
        assert all(-90 <= latitude <= 90 for latitude in ring[1::2])
        steps = [abs(east - west) for west, east in zip(ring[::2], ring[2::2], strict=False)]
        assert all(step < 60 for step in steps[:-1]), "no line across the map"
        assert steps[-1] in (pytest.approx(360, abs=0.1), pytest.approx(min(steps[-1], 59), abs=1e-9))
    singapore_s_neighbour = (102.0, 3.5)  # Malaysia
    assert sum(is_inside(ring, *singapore_s_neighbour) for ring in rings) % 2 == 1
    assert sum(is_inside(ring, -30.0, 30.0) for ring in rings) % 2 == 0, "the Atlantic"


def is_inside(ring, longitude, latitude):
    """By the even-odd rule, on any turn of the globe."""
    points = list(zip(ring[::2], ring[1::2], strict=True))
    return sum(crosses(points, longitude + turn, latitude) for turn in (-360, 0, 360)) % 2 == 1


def crosses(points, x, y):
    found = False
    for (x0, y0), (x1, y1) in zip(points, [*points[1:], points[0]], strict=True):
        if (y0 > y) != (y1 > y) and x < (x1 - x0) * (y - y0) / (y1 - y0) + x0:
            found = not found
    return found
