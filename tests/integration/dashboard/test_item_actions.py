"""Review events by a page's forms: the same events as over the API, validated and refused as there."""

import uuid

import pytest

from tests.integration.conftest import meal_metadata
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair


class Reviewed:
    """A meal that was measured, and the page's forms about it."""

    def __init__(self, state, phone, browser):
        self.browser, self.phone = browser, phone
        metadata = meal_metadata(hints=[{"point": [30, 20], "food": "apple"}])
        assert phone.post(pair(1), metadata).status_code == 202
        estimates.save(state, metadata["id"], found_item(hint=0))
        self.id = metadata["id"]
        self.path = f"/dashboard/studies/pilot/meals/P001/{self.id}"

    def meal(self):
        return self.phone.get(f"/v1/meals/{self.id}").json()

    def send(self, kind, **fields):
        meal = self.meal()
        form = {"id": str(uuid.uuid4()), "kind": kind, "version": meal["version"], "item": meal["items"][0]["id"]}
        return self.browser.post(f"{self.path}/events", headers={"Accept": "application/json"}, **(form | fields))

    def history(self):
        return self.phone.get(f"/v1/meals/{self.id}/events").json()["items"]


@pytest.fixture
def reviewed(state, phone, sign_in_browser):
    return Reviewed(state, phone, sign_in_browser("ann", pilot="reviewer"))


def test_form_makes_the_same_event_as_the_api(reviewed):
    corners = [[10.0, 10.0], [60.0, 10.0], [60.0, 60.0]]
    for said, fields, new in (
        ("confirm", {}, {"status": "confirmed"}),
        ("set_food", {"food": "pear"}, {"food": "pear", "lies_as": None}),
        ("set_mass", {"mass_g": "150.5", "of": "edible", "relative_sd": "0.02"}, {"mass_g": 150.5, "of": "edible"}),
        ("set_volume", {"volume_ml": "120", "mass_g": "", "of": "as_seen"}, {"volume_ml": 120.0}),
        ("set_share", {"share": "0.5"}, {"share": 0.5}),
        ("question", {"text": "Was it <b>yours</b>?"}, {"text": "Was it <b>yours</b>?"}),
        ("redraw", {"polygon": "10, 10\n60 10\n60,60"}, {"polygon": corners}),
    ):
        answer = reviewed.send(said, **fields)
        assert answer.status_code == 201, answer.text
        assert answer.json()["version"] == reviewed.meal()["version"]
        assert answer.headers["etag"] == f'"{reviewed.meal()["version"]}"'
        event = reviewed.history()[-1]
        assert (event["kind"], event["layer"]) == (said, "reviewer")
        assert event["new"].items() >= new.items()


def test_impossible_value_is_refused_with_a_sentence_and_changes_nothing(reviewed):
    before = reviewed.meal()
    for said, fields, words in (
        ("set_mass", {"mass_g": "12,5"}, "Grams: "),
        ("set_mass", {"mass_g": "-5"}, "Grams: This must be 0.001 or more."),
        ("set_mass", {}, "give one of"),
        ("set_volume", {"volume_ml": "nan"}, "Millilitres: "),
        ("redraw", {"polygon": "[" * 5000}, "Outline: "),
        ("redraw", {"polygon": "1,1\n2,2"}, "Outline: "),
        ("comment", {"text": "   "}, "text"),
        ("answer", {"item": "", "text": "yes"}, "This event is not possible"),
        ("hack", {}, "This event is not possible"),
        ("confirm", {"item": "x"}, "This event is not possible"),
        ("confirm", {"mass_g": "1"}, "Grams: This field is not allowed here."),
    ):
        answer = reviewed.send(said, **fields)
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), answer.text
        assert words.lower() in answer.json()["detail"].lower()
    assert reviewed.meal() == before


def test_form_sent_twice_makes_one_event_and_one_of_a_changed_meal_none(reviewed):
    seen, once = reviewed.meal()["version"], str(uuid.uuid4())
    assert reviewed.send("confirm", id=once).status_code == 201
    assert reviewed.send("confirm", id=once, version=seen).status_code == 200
    answer = reviewed.send("comment", text="late", version=seen)
    assert (answer.status_code, answer.json()["code"]) == (412, "precondition_failed")
    assert answer.json()["version"] == reviewed.meal()["version"]
    assert [event["kind"] for event in reviewed.history()] == ["confirm"]


def test_foods_are_offered_as_options_with_escaped_names(client, admin, sign_in_browser):
    tart = {"key": "odd", "name": "<script>alert(1)</script> tart", "group": "x", "form": "slab", "reason": "test"}
    assert client.post("/v1/foods", headers=admin, json=tart).status_code == 201
    client.post("/v1/studies", headers=admin, json={"code": "pilot", "name": "pilot", "marker": "plain:9x7:11"})
    html = sign_in_browser("ann", pilot="viewer").page("/dashboard/studies/pilot/foods", q="tart", list="foods-1")
    assert 'role="option" id="foods-1-1"' in html
    assert 'data-key="odd"' in html
    assert "<script>" not in html
