"""The pages of a study's vessel library: the API's rows, added, remeasured and retired by owners."""

import csv
import io
import re

import pytest

from tests.integration.dashboard.conftest import figures_of, text_of

PATH = "/dashboard/studies/pilot/vessels"
FORM = {"name": "<b>Blue</b> mug", "kind": "mug", "rim_diameter_mm": "82", "height_mm": "95", "capacity_ml": "400.5"}


@pytest.fixture
def library(client, admin):
    """The study's vessels by the API."""

    def read():
        return client.get("/v1/studies/pilot/vessels", headers=admin).json()["items"]

    return read


def test_owner_adds_remeasures_and_retires_a_vessel(owner, library, sign_in_browser):
    answer = owner.post(PATH, **FORM)
    assert answer.status_code == 303, text_of(answer.text)
    (vessel,) = library()
    assert (vessel["name"], vessel["capacity_ml"], vessel["author"]) == ("<b>Blue</b> mug", 400.5, "staff: olga")
    page = owner.page(PATH)
    assert figures_of(page) == [82.0, 95.0, 400.5]
    assert "<b>Blue" not in page
    rows = list(csv.DictReader(io.StringIO(owner.page(PATH, format="csv"))))
    assert [(row["id"], float(row["capacity_ml"])) for row in rows] == [(vessel["id"], 400.5)]
    path = f"{PATH}/{vessel['id']}"
    shown = owner.page(path)
    assert "<polyline" in shown
    assert "straight walls" in text_of(shown)
    viewer = sign_in_browser("vera", pilot="viewer")
    assert "Add a vessel" not in viewer.page(PATH)
    assert "<form" not in viewer.page(path).split("<main", 1)[1]
    profile = "0, 6\r\n35;6\r\n41 95"
    changed = {"kind": "cup", "rim_diameter_mm": "82", "height_mm": "95", "inside_profile_mm": profile, "version": "1"}
    assert owner.post(path, **changed).status_code == 303
    (vessel,) = library()
    assert (vessel["kind"], vessel["capacity_ml"], vessel["version"]) == ("cup", None, 2)
    assert vessel["inside_profile_mm"] == [[0.0, 6.0], [35.0, 6.0], [41.0, 95.0]]
    shown = owner.page(path)
    assert "0, 6\n35, 6\n41, 95" in shown
    assert "as measured" in text_of(shown)
    (end,) = re.findall(r'action="([^"]+/retirement)"', shown)
    assert owner.post(end).status_code == 303
    assert library()[0]["is_retired"]
    assert "retired" in text_of(owner.page(PATH))
    assert "put back in use" in text_of(owner.page(path))
    assert owner.post(path, **changed | {"version": "3"}).status_code == 303
    assert not library()[0]["is_retired"]


def test_form_of_an_older_version_changes_nothing_and_shows_the_current_one(owner, library):
    owner.post(PATH, **FORM)
    (vessel,) = library()
    path = f"{PATH}/{vessel['id']}"
    measures = {name: value for name, value in FORM.items() if name != "name"}
    assert owner.post(path, **measures | {"capacity_ml": "410", "version": "1"}).status_code == 303
    late = owner.post(path, **measures | {"capacity_ml": "420", "version": "1"})
    assert late.status_code == 412
    assert 'value="410"' in late.text
    assert library()[0]["capacity_ml"] == 410.0


def test_refused_vessel_keeps_the_entered_values(owner, library):
    for changes, field in (
        ({"rim_diameter_mm": "8,200"}, "rim_diameter_mm-wrong"),
        ({"kind": "bucket"}, "kind-wrong"),
        ({"name": ""}, "name-wrong"),
        ({"capacity_ml": ""}, "refused"),
        ({"inside_profile_mm": "41"}, "inside_profile_mm-wrong"),
        ({"inside_profile_mm": "<script>, 95"}, "inside_profile_mm-wrong"),
        ({"inside_profile_mm": "0, 6\n82, 95"}, "refused"),
    ):
        answer = owner.post(PATH, **FORM | changes)
        assert answer.status_code == 422
        assert field in answer.text
        assert "<script>," not in answer.text
        assert 'value="95"' in answer.text
    assert library() == []
    owner.post(PATH, **FORM)
    again = owner.post(PATH, **FORM)
    assert (again.status_code, "name-wrong" in again.text) == (409, True), "the name is in use"
    assert len(library()) == 1
