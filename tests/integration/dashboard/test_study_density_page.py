"""The page of a study's own densities: the API's rows, added and withdrawn by owners, escaped text."""

import csv
import io
import re

import pytest
from markupsafe import escape

from tests.integration.dashboard.conftest import figures_of, text_of

PATH = "/dashboard/studies/pilot/densities"
FORM = {"food": "apple", "state": "raw", "kind": "solid", "weighs": "as_seen", "method": "water"}
FORM |= {"reason": "<b>ours</b>"}


@pytest.fixture
def measured(client, admin):
    """The study's densities by the API."""

    def read():
        return client.get("/v1/studies/pilot/densities", headers=admin).json()["items"]

    return read


def test_owner_adds_specimens_and_withdraws_with_a_reason(owner, measured):
    answer = owner.post(PATH, **FORM, specimens="200 168\r\n250 204", volume_step_ml="10", measured_on="2026-11-02")
    assert answer.status_code == 303, text_of(answer.text)
    (told,) = measured()
    assert told["measured_at"].startswith("2026-11-02T00:00:00")
    assert (told["author"], told["specimens"][0]) == ("staff: olga", {"volume_ml": 200.0, "mass_g": 168.0})
    page = owner.page(PATH)
    assert figures_of(page) == [told["g_per_ml"], told["sd_g_per_ml"], 200.0, 168.0, 250.0, 204.0]
    assert "<b>x" not in page
    rows = list(csv.DictReader(io.StringIO(owner.get(PATH, format="csv").text)))
    assert [(row["id"], float(row["g_per_ml"])) for row in rows] == [(told["id"], told["g_per_ml"])]
    (end,) = re.findall(r'action="([^"]+/withdrawal)"', page)
    assert owner.post(end, reason=" ").status_code == 422
    assert owner.post(end, reason="scale was off").status_code == 303
    assert measured()[0]["withdrawal_reason"] == "scale was off"
    assert "scale was off" in owner.page(PATH)
    assert owner.post(end, reason="again").status_code == 409


def test_refused_measurement_keeps_the_entered_values(owner, measured):
    density = {"g_per_ml": "0.8", "sd_g_per_ml": "0.1"}
    for changes, field in (
        ({"food": "moon-rock", "specimens": "200 168\n250 204"}, "food-wrong"),
        ({"specimens": "200 168"}, "specimens-wrong"),
        ({"specimens": "a b"}, "specimens-wrong"),
        ({"g_per_ml": "1,800", "sd_g_per_ml": "0.1"}, "g_per_ml-wrong"),
        (density | {"measured_on": "yesterday"}, "measured_on-wrong"),
        (density | {"measured_on": "2999-01-01"}, "measured_on-wrong"),
        (density | {"method": '"><script>', "kind": "gas"}, "kind-wrong"),
    ):
        answer = owner.post(PATH, **FORM | changes)
        assert answer.status_code in (404, 422)
        assert field in answer.text
        assert "<script>" not in answer.text.split("<main", 1)[1].replace('<script type="application/json">', "")
        assert all(escape(text) in answer.text for name, text in changes.items() if name != "kind")
    assert measured() == []


def test_viewer_sees_densities_without_controls_and_a_stranger_none_at_the_food(owner, sign_in_browser):
    assert owner.post(PATH, **FORM, g_per_ml="0.8125", sd_g_per_ml="0.02").status_code == 303
    viewer = sign_in_browser("vera", pilot="viewer")
    page = viewer.page(PATH)
    assert figures_of(page) == [0.8125, 0.02]
    assert "Withdraw" not in page
    assert "Add a measurement" not in page
    assert "No density of banana" in viewer.page(PATH, food="banana")
    assert 0.8125 in figures_of(viewer.page("/dashboard/foods/apple"))
    assert 0.8125 not in figures_of(sign_in_browser("sam").page("/dashboard/foods/apple"))
