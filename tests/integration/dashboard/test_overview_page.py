"""The overview page: each figure is the API's, in JSON and in files; permissions; studies without places."""

import csv
import io
import json
import re
from datetime import date, timedelta

import pytest
import sqlalchemy as sa

from app.meals.stored.models import Meal
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.models import Participant, Study
from tests.integration.dashboard.conftest import figures_of
from tests.integration.diary.eaten_days import add_meal, close, eaten_item

PATH = "/dashboard/studies/pilot"
WINDOW = {"from": "2026-11-01", "to": "2026-11-06"}


def item(scale, **columns):
    amounts = {name: scale * (10.0 + place / 7) for place, name in enumerate(HEADLINE_COLUMNS)}
    return eaten_item(100.0, **(amounts | columns))


@pytest.fixture
def eaten(enrol, state):
    """Three people: whole days, one of nothing, open ones, late and failed meals, some with a place."""
    phones = {code: enrol(code, location_policy="keep") for code in ("P001", "P002")}
    for number, scale in enumerate((1.0, 1.3, 2.1, 0.4)):
        day = date(2026, 11, 1) + timedelta(days=number)
        add_meal(state, "P001", day, item(scale), item(scale, vitamin_c_mg=None if number == 2 else 9.0))
        if number != 3:
            close(phones["P001"], day)
        add_meal(state, "P002", day, item(scale + 1), hour=19, delay=timedelta(hours=20 + 5 * number))
    close(phones["P002"], date(2026, 11, 2))
    close(phones["P002"], date(2026, 11, 5), ate_nothing=True)
    for status in ("queued", "needs_review", "failed", "failed"):
        add_meal(state, "P002", "2026-11-06", status=status)
    with state.database.write() as session:
        for meal in session.scalars(sa.select(Meal).where(Meal.status == "failed")):
            meal.failure_code = "marker_not_found"
        located = session.scalars(sa.select(Meal).where(Meal.local_date < date(2026, 11, 4)).order_by(Meal.id))
        for number, meal in enumerate(located):
            meal.details = {"location": {"latitude": 48.2 + number / 100, "longitude": -16.37}}


def table_of(html, name):
    """The figures of a table, in its order."""
    return figures_of(re.search(rf'<table [^>]*data-of="{name}".*?</table>', html, re.DOTALL)[0])


def charts_of(html):
    found = re.findall(r'<figure data-chart="(\w+)">.*?<script type="application/json">(.*?)</script>', html, re.DOTALL)
    return {name: json.loads(text) for name, text in found}


def known(values):
    """Those that are known: the others are a dash, and no figure."""
    return [value for value in values if value is not None]


def values_of(rows, *names):
    return known([row[name] for row in rows for name in names])


@pytest.fixture
def told(client, admin, eaten):
    return client.get("/v1/studies/pilot/overview", headers=admin, params=WINDOW).json()


@pytest.fixture
def html(eaten, sign_in_browser):
    return sign_in_browser("vera", pilot="viewer").page(PATH, **WINDOW, component="fat_g")


def test_every_figure_of_the_page_is_the_api_s(told, html):
    days, whole, people = told["days"], told["completeness"], told["participants"]
    now, rest = html.split('id="window"')
    waiting = {row["status"]: row["meals"] for row in told["waiting"]}
    shown = ("receiving", "queued", "processing", "needs_look", "after_awaited", "failed")
    assert figures_of(now) == [*(waiting[name] for name in shown), *values_of(told["failures"], "meals")]
    head = figures_of(rest[: rest.index('<div class="panels">')])
    assert head == [
        *(people[name] for name in ("everybody", "active", "withdrawn")),
        *(whole[name] for name in ("meals", "expected", "told", "silent", "closed", "whole", "late_meals")),
        whole["median_delay_seconds"],
    ]
    statuses = [f"{status}_meals" for status in ("confirmed", "estimated", "needs_review", "failed")]
    assert table_of(html, "meals") == values_of(days, "meals", *statuses)
    completeness = ("expected", "told_closed", "told_open", "silent", "whole")
    assert table_of(html, "completeness") == values_of(days, *completeness)
    energy = ("whole", "whole_energy_kcal", "open_days", "open_energy_kcal")
    assert table_of(html, "energy") == values_of(days, *energy)
    assert table_of(html, "late") == values_of(days, "meals", "late_meals", "late_share", "median_delay_seconds")
    nutrients = ("days", "mean", "sd", "sd_between_persons", "median", "minimum", "maximum")
    assert table_of(html, "nutrients") == values_of(told["nutrients"], *nutrients)
    persons = [row["meals"] for row in told["person_days"] if row["meals"] or row["closed"]]
    assert table_of(html, "persons") == persons
    assert html.count('class="is-silent"') == sum(day["silent"] for day in days)
    bins = [row for row in told["histograms"] if row["component"] == "fat_g"]
    assert table_of(html, "histogram") == values_of(bins, "from_amount", "to_amount", "days")
    assert table_of(html, "places") == values_of(told["places"], "latitude", "longitude")
    assert len(told["places"]) == told["located_meals"] > 3
    assert {0.5, whole["median_delay_seconds"]} < set(figures_of(html))  # a share and a delay are among them


def test_map_and_charts_of_delays_are_behind_a_fold(html):
    closed = re.findall(r"<details><summary>(?:Map of places|Charts of delays)</summary>.*?</details>", html, re.DOTALL)
    folded = "".join(closed)
    assert all(html.count(part) == folded.count(part) == 1 for part in ('data-chart="late"', "<figure data-map"))


def test_charts_draw_the_numbers_of_the_api(told, html):
    charts, days = charts_of(html), told["days"]
    drawn = {name: [series["values"] for series in chart["series"]] for name, chart in charts.items()}
    columns = {
        "meals": ["meals"],
        "completeness": ["told_closed", "told_open", "silent"],
        "energy": ["whole_energy_kcal", "open_energy_kcal"],
        "delay": ["median_delay_seconds"],
    }
    for name, names in columns.items():
        assert drawn[name] == [[day[column] for day in days] for column in names], name
        assert charts[name]["labels"] == [day["local_date"] for day in days]
    assert [series["counts"] for series in charts["energy"]["series"]] == [
        [day[column] for day in days] for column in ("whole", "open_days")
    ]
    assert known(drawn["late"][0]) == pytest.approx([100 * day["late_share"] for day in days if day["meals"]])
    (fat,) = (row for row in told["nutrients"] if row["component"] == "fat_g")
    bins = [row for row in told["histograms"] if row["component"] == "fat_g"]
    assert drawn["nutrient"] == [[row["days"] for row in bins]]
    assert charts["nutrient"]["edges"] == [*(row["from_amount"] for row in bins), bins[-1]["to_amount"]]
    assert [mark["at"] for mark in charts["nutrient"]["marks"]] == [fat["mean"], fat["median"]]


def test_files_of_the_page_have_the_rows_of_the_api_and_are_audited(client, admin, told, html, sign_in_browser):
    browser = sign_in_browser("rita", pilot="reviewer")
    parts = {re.search(r"part=(\w+)", link)[1]: link for link in re.findall(r'href="([^"]+format=csv[^"]*)"', html)}
    assert set(parts) == {"days", "histograms", "nutrients", "person_days", "places"}
    for part, link in parts.items():
        rows = list(csv.DictReader(io.StringIO(browser.page(link.replace("&amp;", "&")))))
        assert rows == [
            {name: "" if value is None else str(value) for name, value in row.items()} for row in told[part]
        ]
    (whole,) = set(re.findall(r'href="([^"]+/overview\?[^"]+)" download="overview.json"', html))
    assert json.loads(browser.page(whole.replace("&amp;", "&"))) == told
    log = client.get("/v1/studies/pilot/audit", headers=admin, params={"action": "overview.export"}).json()["items"]
    assert {event["details"]["part"] for event in log} == set(parts)


def test_window_is_chosen_by_a_number_of_days_or_by_its_ends(eaten, sign_in_browser):
    viewer = sign_in_browser("vera", pilot="viewer")

    def window(**params):
        return re.findall(
            r'"window"><time datetime="([\d-]+)">.*?</time> to <time datetime="([\d-]+)"', viewer.page(PATH, **params)
        )

    assert window() == window(days="28") == [("2026-10-10", "2026-11-06")]
    assert window(days="7") == [("2026-10-31", "2026-11-06")]
    assert window(days="all") == [("2026-11-01", "2026-11-06")]
    assert window(**{"from": "2026-11-02", "to": ""}) == [("2026-11-02", "2026-11-06")]
    refused = viewer.get(PATH, **{"from": "2026-11-05", "to": "2026-11-04"})
    assert (refused.status_code, 'value="2026-11-05"' in refused.text) == (422, True)
    assert "The first day lies after the last: 2026-11-05, 2026-11-04." in refused.text


def test_page_shows_no_dropped_place_and_no_code_that_ends_a_script(eaten, state, sign_in_browser):
    with state.database.write() as session:
        session.scalars(sa.select(Study)).one().location_policy = "drop"
        for number, person in enumerate(session.scalars(sa.select(Participant))):
            person.code = f"</script><script>alert({number})</script>"
    page = sign_in_browser("vera", pilot="viewer").page(PATH, **WINDOW)
    assert "data-map" not in page
    assert "map.js" not in page
    assert "48.2" not in page
    assert "alert(" in page
    assert "<script>alert" not in page
