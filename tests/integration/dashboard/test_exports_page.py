"""The exports page: its options and figures are the API's, its files the API's bytes; permissions."""

import html
import re

import pytest

from app.exports.background_exports import MOST_OF_PERSON
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.diary.eaten_days import add_meal, eaten_item

PATH = "/dashboard/studies/pilot/exports"
API = "/v1/studies/pilot/exports"
pytestmark = pytest.mark.usefixtures("eaten")


@pytest.fixture
def eaten(enrol, state):
    for code in ("P001", "P002"):
        enrol(code)
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, "apple", energy_kcal=52.0))
    add_meal(state, "P002", "2026-11-02", eaten_item(50.0, "banana"), eaten_item(None, status="needs_review"))


def listed(page):
    """The part of the page that lists what was made."""
    return page[page.index('id="exports-list"') :]


def follow(browser, address):
    """What a link leads to."""
    answer = browser.get(html.unescape(address))
    assert answer.status_code == 200, answer.text
    return answer


def test_download_is_the_file_of_the_api_with_the_same_filters(client, admin, viewer):
    empty = {"participant": "", "origin": "", "from": ""}  # fields that a browser sends though nothing is in them
    for rows, address, asked in (
        ("items", "/v1/records", {"status": ["confirmed"], "from": "2026-11-01"}),
        ("items", "/v1/records", {"layout": "long", "components": "all", "food": "apple"}),
        ("items", "/v1/records", {"format": "parquet", "provenance": "false"}),
        ("items", "/v1/records", {"format": "geojson"}),
        ("meals", "/v1/meals", {"format": "ndjson", "status": ["estimated", "failed"], "needs": "review"}),
        ("days", "/v1/days", {"participant": "P002", "to": "2026-11-02"}),
        ("photographs", "/v1/studies/pilot/photographs", {}),
        ("participants", "/v1/studies/pilot/participants", {}),
    ):
        here = viewer.get(f"{PATH}/table", rows=rows, **(empty | asked))
        of_study = {} if "/studies/" in address else {"study": "pilot"}
        there = client.get(address, params={"format": "csv"} | of_study | asked, headers=admin)
        assert here.status_code == there.status_code == 200, (here.text, there.text)
        assert here.content == there.content
        assert len(here.content) > 0
        for name in ("content-type", "content-disposition", "cache-control"):
            assert here.headers[name] == there.headers[name]


def test_figures_of_the_list_are_those_of_the_api(client, admin, viewer, run):
    answer = viewer.post(PATH, rows="items", format="parquet", status="confirmed", **{"from": "2026-11-01"})
    assert answer.status_code == 303
    waiting = viewer.page(PATH)
    assert 'hx-get="/dashboard/studies/pilot/exports/list"' in listed(waiting)
    assert "queued" in text_of(listed(waiting))
    assert run().outcome == "done"
    page = viewer.page(PATH)
    assert "hx-get" not in listed(page)
    (export,) = client.get(API, headers=admin).json()["items"]
    assert figures_of(listed(page)) == [export["rows_written"], export["bytes"], export["change_seq"]]
    assert export["sha256"] in page
    assert export["asked_by"] == "vera"
    assert "from: 2026-11-01 status: confirmed" in text_of(listed(page))
    file = viewer.get(f"{PATH}/{export['id']}/file")
    assert file.content == client.get(export["file"], headers=admin).content
    rest = viewer.get(f"{PATH}/{export['id']}/file", headers={"Range": "bytes=100-"})
    assert (rest.status_code, rest.content) == (206, file.content[100:])


def test_export_is_cancelled_or_removed_by_its_requester_and_by_owners_of_its_study(
    client, admin, viewer, enrol, sign_in_browser, run
):
    assert viewer.post(PATH, rows="items").status_code == 303
    assert viewer.post(PATH, rows="meals").status_code == 303
    meals, items = client.get(API, headers=admin).json()["items"]
    enrol("X1", study="other")
    other, owner = sign_in_browser("otto", pilot="viewer"), sign_in_browser("olga", pilot="owner", other="owner")
    assert "/removal" not in listed(other.page(PATH))
    assert other.post(f"{PATH}/{items['id']}/removal").status_code == 403
    elsewhere = PATH.replace("pilot", "other")
    assert owner.get(f"{elsewhere}/{items['id']}/file").status_code == 404
    assert owner.post(f"{elsewhere}/{items['id']}/removal").status_code == 404
    assert viewer.post(f"{PATH}/{items['id']}/removal").status_code == 303
    assert "was cancelled" in viewer.page(PATH)
    assert run().outcome == "done"
    assert f"{PATH}/{meals['id']}/removal" in listed(owner.page(PATH))
    assert owner.post(f"{PATH}/{meals['id']}/removal").status_code == 303
    left = client.get(API, headers=admin).json()["items"]
    assert [(each["id"], each["state"]) for each in left] == [(items["id"], "cancelled")]


def test_refused_export_shows_why_and_keeps_the_entered_values(client, admin, viewer):
    for asked, sentence in (
        ({"rows": "items", "layout": "long", "format": "geojson"}, "GeoJSON has one feature"),
        ({"rows": "items", "from": "2026-11-03", "to": "2026-11-02"}, "The first day lies after the last: 2026-11-03"),
        ({"rows": "items", "from": "yesterday", "participant": '"><script>alert(1)'}, "Write a day as 2026-11-30."),
        ({"rows": "items", "status": "estimated"}, "There is no"),
        ({"rows": "photographs", "components": "all"}, "Photographs have no components"),
    ):
        answer = viewer.post(PATH, **asked)
        assert answer.status_code == 422, asked
        assert sentence in html.unescape(text_of(answer.text)), asked
        assert "<script>alert" not in answer.text
        for name in ("from", "to"):
            assert f'name="{name}" type="date" value="{asked.get(name, "")}"' in answer.text
        assert viewer.get(f"{PATH}/table", **asked).status_code == 422
    assert client.get(API, headers=admin).json()["items"] == []


def test_switching_the_table_keeps_the_options_that_it_offers(viewer):
    page = viewer.page(PATH, rows="meals", status=["failed"], flag="low_texture", **{"from": "2026-11-02"})
    assert 'value="low_texture" checked' in page
    (address,) = re.findall(r'href="([^"]+rows=days[^"]*)"', page)
    days = follow(viewer, address).text
    assert 'type="date" value="2026-11-02"' in days
    assert "flag" not in days[days.index('<form method="get"') : days.index("Download now")]


def test_limit_of_exports_is_shown_on_the_page(viewer, state):
    tables = ["items", "meals", "days", "photographs"]
    answers = [viewer.post(PATH, rows=rows) for rows in tables]
    assert [answer.status_code for answer in answers] == [303] * MOST_OF_PERSON + [429]
    assert "the limit" in text_of(answers[-1].text)
