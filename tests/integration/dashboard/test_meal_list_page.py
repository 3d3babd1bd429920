"""The page of a study's meals: the API's rows and figures by the same filters; polling of unfinished meals."""

import csv
import html
import io
import json
import re
import uuid

import pytest

from app.people.access.page_rules import POLLED
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.diary.eaten_days import add_meal
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import found_item, unmeasured_item
from tests.support.photographs import pair

PAGE = "/dashboard/studies/pilot/meals"
CHANGED = "/dashboard/studies/pilot/changed-meals"
LINE = re.compile(r'<tr id="meal-[^"]*">.*?</tr>', re.DOTALL)
CARD = re.compile(r'<li class="meal-card".*?</li>', re.DOTALL)
HTMX = {"HX-Request": "true"}
FAILURE = {"code": "marker_not_found", "message": "No board.", "advice": "Lay it."}


@pytest.fixture
def various(client, admin, meal_of):
    """Five meals of two people, the oldest first."""
    meals = [
        meal_of(found_item(150.0), found_item(80.0), found_item(60.0), captured_at="2026-11-17T12:00:00+00:00"),
        meal_of(found_item(flags=["low_texture"]), participant="P002", captured_at="2026-11-18T12:00:00+00:00"),
        meal_of(unmeasured_item(), participant="P002", captured_at="2026-11-19T12:00:00+00:00"),
        meal_of(failure=FAILURE, captured_at="2026-11-20T12:00:00+00:00"),
        meal_of(captured_at="2026-11-21T12:00:00+00:00"),
    ]
    speaker = Speaker(client, admin, meals[0])
    speaker.say("reject", item=speaker.items()[1]["id"])
    speaker.say("set_food", item=speaker.items()[2]["id"], food="banana")
    return meals


def ids(parts):
    return [re.search(r'id="meal-[\w-]*?-([0-9a-f]{8}-[0-9a-f-]{27})"', part)[1] for part in parts]


def follow(browser, address, **options):
    """The answer at an address of a page."""
    return browser.get(html.unescape(address), **options)


def told(*values):
    return [value for value in values if value is not None]


def test_rows_and_figures_are_those_of_the_api_and_of_the_files(client, admin, various, viewer):
    names = ("participant", "from", "to", "food", "flag", "failure", "needs", "origin")
    for params in (
        {},
        {"status": ["queued", "needs_review"], "participant": "P002"},
        {"status": ["failed"], "failure": ["marker_not_found", "baseline_too_small"]},
        {"flag": ["low_texture", "inside_guessed"]},
        {"food": ["banana"], "from": "2026-11-16", "to": "2026-11-18"},
        {"needs": "review", "order": "oldest"},
        {"origin": "declared"},
        {"after_status": ["failed"]},
    ):
        rows = client.get("/v1/meals", headers=admin, params={"study": "pilot"} | params).json()["items"]
        lines = LINE.findall(viewer.page(PAGE, **dict.fromkeys(names, "") | params, view="table"))
        page = viewer.page(PAGE, **params)
        assert ("No meals match these filters" in page) is (not rows)
        cards = CARD.findall(page)
        assert ids(lines) == ids(cards) == [row["id"] for row in rows]
        file = viewer.page(PAGE, **params, rows="meals", format="csv")
        in_file = {row["meal_id"]: row for row in csv.DictReader(io.StringIO(file.removeprefix("\ufeff")))}
        assert set(in_file) == {row["id"] for row in rows}
        for line, card, row in zip(lines, cards, rows, strict=True):
            sums = told(row["consumed_g"], row["energy_kcal"], row["doubt"])
            assert figures_of(line) == pytest.approx([row["item_count"], *sums, row["upload_delay_seconds"]], rel=1e-12)
            of_card = told(row["energy_kcal"], row["consumed_g"], row["doubt"])
            assert figures_of(card) == pytest.approx(of_card, rel=1e-12)
            own = in_file[row["id"]]
            of_file = [float(own[name]) for name in ("consumed_g", "energy_kcal", "doubt") if own[name]]
            assert of_file == pytest.approx(sums, rel=1e-9)
            assert f"status-{row['status']}" in line
            assert f"status-{row['status']}" in card
            for food in row["foods"]:
                assert html.escape(food["name"]) in line


def test_set_filters_are_shown_in_the_form_and_refused_ones_are_named(viewer):
    foods = ["apple", "gone <b>", ""]
    options = {"flag": "low_texture", "view": "table", "order": "oldest", "participant": '"><b>'}
    page = viewer.page(PAGE, status=["failed", "queued"], food=foods, **options)
    assert "<b>" not in page
    ticked = set(re.findall(r'name="(\w+)" value="([^"]+)" checked', page))
    wanted = {("status", "failed"), ("status", "queued"), ("flag", "low_texture")}
    assert ticked == wanted | {("food", "apple"), ("food", "gone &lt;b&gt;")}
    assert "Apple, raw, with skin" in page
    assert "No food of the tables has the key “gone &lt;b&gt;”" in text_of(page)
    assert "“apple”" not in page
    assert '<input type="hidden" name="view" value="table">' in page
    assert '<option value="oldest" selected>' in page
    assert "No food of the tables has the key" not in viewer.page(PAGE, food=["apple", ""])
    for asked, told in (
        ({"from": "2026-11-20", "to": "2026-11-01"}, "The first day lies after the last: 2026-11-20, 2026-11-01."),
        ({"status": "eaten"}, "Status: There is no such choice; choose: receiving"),
        ({"from": "yesterday"}, "From: Write a day as 2026-11-30."),
    ):
        answer = viewer.get(PAGE, **asked)
        assert answer.status_code == 422
        assert told in text_of(answer.text)
        assert "query" not in answer.text
        if "to" in asked:
            assert 'value="2026-11-20"' in answer.text


def test_pages_follow_one_another_with_their_filters(state, viewer):
    meals = [str(add_meal(state, "P001", f"2026-10-{1 + n:02d}", status="queued")) for n in range(26)]
    page = viewer.page(PAGE, status=["queued"])
    following = re.search(r'href="([^"]*)" rel="next"', page)[1]
    assert "status=queued" in following
    second = follow(viewer, following).text
    assert ids(CARD.findall(page)) + ids(CARD.findall(second)) == meals[::-1]
    assert 'rel="next"' not in second
    assert 'rel="first"' in second


def test_counts_by_status_are_the_apis_and_each_leads_to_its_meals_and_files(client, admin, various, viewer):
    answer = client.get("/v1/studies/pilot/meal-counts", headers=admin).json()
    counts = [count for count in answer["items"] if count["status"] != "needs_review"]
    nav = re.search(r'<nav aria-label="All meals.*?</nav>', viewer.page(PAGE), re.DOTALL)[0]
    assert figures_of(nav) == [answer["needs_look"], *(each["count"] for each in counts)]
    for each in counts:
        assert f'href="{PAGE}?status={each["status"]}"' in nav
        assert len(CARD.findall(viewer.page(PAGE, status=each["status"]))) == each["count"]
    links = re.findall(r'href="([^"]*format=[^"]*)"', viewer.page(PAGE, participant="P002"))
    assert len(links) == 11
    for link in links:
        answer = follow(viewer, link)
        assert (answer.status_code, "attachment" in answer.headers["content-disposition"]) == (200, True), link
        if link.endswith("format=geojson") and "rows=meals" in link:
            assert len(json.loads(answer.text)["features"]) == 2
        if link.endswith("format=ndjson"):
            rows = [json.loads(line) for line in answer.text.splitlines()]
            assert {row["meal_id"] for row in rows} == {various[1], various[2]}
    assert viewer.get(PAGE, status="failed", rows="items", format="csv").status_code == 422
    of_status = viewer.page(PAGE, status="failed")
    assert "rows=items" not in of_status
    assert "Items have the filters participant, days and foods" in of_status


def test_most_doubtful_meal_comes_first_by_choice(client, admin, various, viewer):
    rows = client.get("/v1/meals", headers=admin, params={"study": "pilot"}).json()["items"]
    doubts = {row["id"]: row["doubt"] for row in rows if row["doubt"] is not None}
    page = viewer.page(PAGE, order="doubt")
    assert ids(CARD.findall(page)) == sorted(doubts, key=doubts.get, reverse=True)
    assert 'value="doubt" selected' in page


def watch_of(page):
    """The address that the page polls, and the meals that it asks about."""
    address = html.unescape(re.search(r'id="meals-watch" hx-get="([^"]*)"', page)[1])
    return address, {one.split(":")[1] for one in re.findall(r"meal=([^&]*)", address)}


def test_unfinished_meals_are_polled_together_and_replaced_in_place(client, admin, state, meal_of, viewer):
    waiting, other, erased = meal_of(), meal_of(participant="P002"), meal_of(participant="P003")
    meal_of(found_item())  # measured: not polled
    watch, polled = watch_of(viewer.page(PAGE))
    assert polled == {waiting, other, erased}
    assert follow(viewer, watch, headers=HTMX).status_code == 204
    assert client.delete(f"/v1/meals/{erased}", headers=admin).status_code == 200
    answer = follow(viewer, watch, headers=HTMX)
    assert f'<hx-partial hx-target="#meal-P003-{erased}" hx-swap="delete">' in answer.text
    assert "A meal of P003 no longer exists" in text_of(answer.text)
    watch, polled = watch_of(answer.text)
    assert polled == {waiting, other}
    assert follow(viewer, watch, headers=HTMX).status_code == 204
    estimates.save(state, waiting, found_item(volume_ml=120.0))
    answer = follow(viewer, watch, headers=HTMX)
    assert answer.status_code == 200
    assert "<html" not in answer.text
    assert ids(CARD.findall(answer.text)) == [waiting]
    assert f'hx-target="#meal-P001-{waiting}" hx-swap="outerMorph"' in answer.text
    assert re.search(r'hx-target="#meals-live".*Apple.*: estimated\.', answer.text)
    watch, polled = watch_of(answer.text)
    assert polled == {other}
    estimates.save(state, other, failure=FAILURE)
    last = follow(viewer, watch, headers=HTMX)
    assert "marker not found" in text_of(last.text)
    assert 'id="meals-watch" ></div>' in last.text
    assert ("GET", CHANGED.replace("pilot", "{study}")) in POLLED
    lines = viewer.get(CHANGED, headers=HTMX, view="table", meal=f"P001:{waiting}:1").text
    assert ids(LINE.findall(lines)) == [waiting]


def test_polling_reveals_nothing_of_another_participant_or_study(enrol, meal_of, sign_in_browser):
    meal_id = meal_of()
    elsewhere = enrol("P001", study="second").post(pair(3)).json()["id"]
    browser = sign_in_browser("ann", pilot="viewer", second="viewer")
    for known in (f"P002:{meal_id}:9", f"P001:{elsewhere}:9", f"P001:{uuid.uuid4()}:1"):
        told = text_of(browser.get(CHANGED, headers=HTMX, meal=known).text)
        assert told.split() == f"A meal of {known[:4]} no longer exists.".split()
    assert browser.get(CHANGED, headers=HTMX, meal=f"P001:{meal_id}:9").status_code == 200
    assert browser.get(CHANGED, headers=HTMX, meal="P001:x:1").status_code == 422
