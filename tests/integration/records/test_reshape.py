"""A reviewer gives an item a form by hand: its volume is the form's, until the event is undone."""

import math

import pytest

from app.meals.stored.outline_json import rings_of
from app.records.recompute_records import rebuild_records
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import found_item, scene_artefact
from tests.support.photographs import pair

FORM = {
    "section": "prism",
    "centre_mm": [80.0, -12.5],
    "length_mm": 100.0,
    "width_mm": 60.0,
    "height_mm": 30.0,
    "yaw_deg": -30.0,
    "lean_deg": 10.0,
    "base_mm": 4.0,
}
FORM_ML = math.pi / 4 * 100 * 60 * 30 / 1000


@pytest.fixture
def body(phone, state):
    body = meal_metadata(hints=[{"point": [30, 20], "food": "apple"}])
    assert phone.post(pair(), body).status_code == 202
    return body


@pytest.fixture
def measured(body, state):
    estimates.save(state, body["id"], found_item(), artefacts=[scene_artefact(state)])


@pytest.fixture
def reviewer(client, admin, body):
    return Speaker(client, admin, body["id"])


@pytest.fixture
def participant(phone, client, body):
    return Speaker(client, phone.headers, body["id"])


def reshape(speaker, **fields):
    return speaker.say("reshape", item=speaker.items()[0]["id"], form=FORM | fields)["items"][0]


@pytest.mark.usefixtures("measured")
def test_volume_grams_and_nutrients_follow_from_the_form(reviewer, state):
    before = reviewer.items()[0]
    item = reshape(reviewer)
    low_ml, high_ml = item["volume_interval_ml"]
    assert item["volume_ml"] == pytest.approx(FORM_ML)
    assert low_ml < FORM_ML * 0.9 < FORM_ML * 1.1 < high_ml  # 10 %, as of any volume that a person states
    assert (item["status"], item["reviewed"], item["polygon"]) == ("corrected", True, before["polygon"])
    for name in ("mass_g", "edible_g", "consumed_g"):
        assert item[name] / before[name] == pytest.approx(FORM_ML / before["volume_ml"])
    energy, energy_before = item["nutrients"][0]["amount"], before["nutrients"][0]["amount"]
    assert energy / energy_before == pytest.approx(FORM_ML / before["volume_ml"])
    assert rebuild_records(state.database, write=False).different == 0


@pytest.mark.usefixtures("measured")
def test_history_has_the_form_and_its_volume_and_undo_brings_the_estimate_back(reviewer):
    before = reviewer.items()[0]
    reshape(reviewer)
    (event,) = reviewer.history()["items"]
    assert (event["kind"], event["layer"], event["new"]["form"]) == ("reshape", "reviewer", FORM)
    assert event["new"]["volume_ml"] == pytest.approx(FORM_ML)
    assert event["new"]["run"] == reviewer.meal()["run"]["id"]
    assert event["old"] == {"volume_ml": before["volume_ml"]}
    item = reviewer.say("undo", event=event["id"])["items"][0]
    assert {**item, "etag": None} == {**before, "etag": None}


@pytest.mark.usefixtures("measured")
def test_newer_statement_of_the_amount_counts_and_a_narrower_spread_is_taken(reviewer):
    item_id = reviewer.items()[0]["id"]
    wide = reshape(reviewer)["volume_interval_ml"]
    narrow = reviewer.say("reshape", item=item_id, form=FORM, relative_sd=0.02)["items"][0]["volume_interval_ml"]
    assert wide[0] < narrow[0] < FORM_ML < narrow[1] < wide[1]
    assert reviewer.say("set_mass", item=item_id, mass_g=50)["items"][0]["mass_g"] == 50.0
    assert reshape(reviewer)["mass_g"] != 50.0


@pytest.mark.usefixtures("measured")
def test_smallest_form_has_a_volume_and_one_too_large_or_of_a_participant_is_refused(reviewer, participant):
    item = reviewer.items()[0]["id"]
    assert reviewer.refused("reshape", item=item, form=FORM | {"height_mm": -3.0}) == (422, "invalid_input")
    huge = FORM | {"length_mm": 600, "width_mm": 600, "height_mm": 600}
    assert reviewer.refused("reshape", item=item, form=huge) == (422, "form_too_large")
    assert participant.refused("reshape", item=item, form=FORM) == (403, "event_not_yours")
    assert reviewer.history()["items"] == []
    least = {"section": "ellipsoid", "length_mm": 2, "width_mm": 2, "height_mm": 2}
    assert reshape(reviewer, **least)["volume_ml"] == pytest.approx(math.pi / 6 * 0.008)


def test_meal_without_a_scene_says_so(body, state, reviewer):
    estimates.save(state, body["id"], found_item())
    assert reviewer.refused("reshape", item=reviewer.items()[0]["id"], form=FORM) == (409, "scene_missing")


def test_rings_that_a_meal_has_are_accepted_by_redraw(body, state, reviewer):
    polygons = {
        "one ring": [[10.25, 10.5], [50.0, 10.0], [50.0, 50.125]],
        "a hole": [[[0.0, 0.0], [90.0, 0.0], [90.0, 90.0], [0.0, 90.0]], [[20.5, 20.5], [20.5, 60.0], [60.0, 60.0]]],
        "rings that enclose nothing": [
            [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]],
            [[30.0, 30.0], [31.0, 31.0]],
            [[5.0, 5.0]],
        ],
        "many merged items": [[[float(x), float(x % 7)] for x in range(20)] for _ in range(120)],
    }
    estimates.save(state, body["id"], *(found_item(hint=None, polygon=polygon) for polygon in polygons.values()))
    for item in reviewer.items():
        reviewer.say("redraw", item=item["id"], polygon=item["polygon"])
    drawn = [event["new"]["polygon"] for event in reviewer.history()["items"]]
    assert drawn == [item["polygon"] for item in reviewer.items()]
    assert drawn == [rings_of(polygon) for polygon in polygons.values()]
