"""Review events by a page's forms: the same events as over the API, validated and refused as there."""

import uuid

import pytest

from tests.integration.conftest import meal_metadata
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair


class Reviewed:
    """A meal that was measured, and the page's forms about it."""

    def __init__(self, state, phone, browser, study="pilot", participant="P001"):
        self.browser, self.phone = browser, phone
        metadata = meal_metadata(hints=[{"point": [30, 20], "food": "apple"}])
        assert phone.post(pair(1), metadata).status_code == 202
        estimates.save(state, metadata["id"], found_item(hint=0))
        self.id = metadata["id"]
        self.path = f"/dashboard/studies/{study}/meals/{participant}/{self.id}"

    def meal(self):
        return self.phone.get(f"/v1/meals/{self.id}").json()

    def item(self):
        return self.meal()["items"][0]

    def send(self, kind, *, accept="application/json", **fields):
        meal = self.meal()
        form = {"id": str(uuid.uuid4()), "kind": kind, "version": meal["version"], "item": meal["items"][0]["id"]}
        form = {name: value for name, value in (form | fields).items() if value is not None}
        return self.browser.post(f"{self.path}/events", headers={"Accept": accept}, **form)

    def history(self):
        return self.phone.get(f"/v1/meals/{self.id}/events").json()["items"]


@pytest.fixture
def reviewed(state, phone, sign_in_browser):
    return Reviewed(state, phone, sign_in_browser("ann", pilot="reviewer"))


@pytest.mark.parametrize(
    ("said", "fields", "new"),
    [
        ("confirm", {}, {"status": "confirmed"}),
        ("set_food", {"food": "pear"}, {"food": "pear", "lies_as": None}),
        ("set_mass", {"mass_g": "150.5", "of": "edible", "relative_sd": "0.02"}, {"mass_g": 150.5, "of": "edible"}),
        ("set_volume", {"volume_ml": "120", "mass_g": "", "of": "as_seen"}, {"volume_ml": 120.0}),
        ("set_share", {"share": "0.5"}, {"share": 0.5}),
        ("redraw", {"polygon": "10, 10\n60 10\n60,60"}, {"polygon": [[10.0, 10.0], [60.0, 10.0], [60.0, 60.0]]}),
        ("redraw", {"polygon": "[[10,10],[60,10],[60,60]]"}, {"polygon": [[10.0, 10.0], [60.0, 10.0], [60.0, 60.0]]}),
        ("question", {"text": "Was it <b>yours</b>?"}, {"text": "Was it <b>yours</b>?"}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_form_makes_the_same_event_as_the_api(reviewed, said, fields, new):
    answer = reviewed.send(said, **fields)
    assert answer.status_code == 201, answer.text
    assert answer.json()["version"] == reviewed.meal()["version"]
    assert answer.headers["etag"] == f'"{reviewed.meal()["version"]}"'
    event = reviewed.history()[-1]
    assert (event["kind"], event["layer"]) == (said, "reviewer")
    assert event["new"].items() >= new.items()


@pytest.mark.parametrize(
    ("said", "fields", "words"),
    [
        ("set_mass", {"mass_g": "12,5"}, "Grams: "),
        ("set_mass", {}, "give one of"),
        ("set_volume", {"volume_ml": "-3"}, "Millilitres: "),
        ("set_volume", {"volume_ml": "nan"}, "Millilitres: "),
        ("redraw", {"polygon": "10, 10\nhere"}, "Outline: "),
        ("redraw", {"polygon": "[" * 5000}, "Outline: "),
        ("redraw", {"polygon": "1,1\n2,2"}, "Outline: "),
        ("comment", {"text": "   "}, "text"),
        ("answer", {"item": "", "text": "yes"}, "This event is not possible"),
        ("hack", {}, "This event is not possible"),
        ("confirm", {"item": "x"}, "This event is not possible"),
        ("confirm", {"mass_g": "1"}, "Grams: This field is not allowed here."),
        ("set_mass", {"mass_g": "-5"}, "Grams: This must be 0.001 or more."),
    ],
    ids=str,
)
def test_impossible_value_is_refused_with_a_sentence_and_changes_nothing(reviewed, said, fields, words):
    before = reviewed.meal()
    answer = reviewed.send(said, **fields)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), answer.text
    assert words.lower() in answer.json()["detail"].lower()
    assert reviewed.meal() == before


def test_form_sent_twice_makes_one_event(reviewed):
    once = str(uuid.uuid4())
    assert reviewed.send("confirm", id=once).status_code == 201
    assert reviewed.send("confirm", id=once, version=1).status_code == 200
    assert [event["kind"] for event in reviewed.history()] == ["confirm"]


def test_form_of_a_changed_meal_is_refused(reviewed):
    seen = reviewed.meal()["version"]
    assert reviewed.send("comment", text="first").status_code == 201
    answer = reviewed.send("confirm", version=seen)
    assert (answer.status_code, answer.json()["code"]) == (412, "precondition_failed")
    assert answer.json()["version"] == reviewed.meal()["version"]


def test_meal_of_another_study_is_not_found_even_by_a_reviewer_of_both(state, enrol, sign_in_browser):
    phones = {study: enrol("P001", study=study) for study in ("pilot", "second")}
    ann = sign_in_browser("ann", pilot="reviewer", second="reviewer")
    other = Reviewed(state, phones["second"], ann, study="second")
    other.path = other.path.replace("/second/", "/pilot/")
    assert other.send("confirm").status_code == 404
    assert other.history() == []


def test_viewer_changes_nothing(state, phone, sign_in_browser):
    seen = Reviewed(state, phone, sign_in_browser("vic", pilot="viewer"))
    answer = seen.send("confirm")
    assert (answer.status_code, answer.json()["code"]) == (403, "role_too_low")
    assert seen.history() == []


def test_foods_are_offered_as_options_with_escaped_names(client, admin, sign_in_browser):
    tart = {"key": "odd", "name": "<script>alert(1)</script> tart", "group": "x", "form": "slab", "reason": "test"}
    made = client.post("/v1/foods", headers=admin, json=tart)
    assert made.status_code == 201, made.text
    client.post("/v1/studies", headers=admin, json={"code": "pilot", "name": "pilot", "marker": "plain:9x7:11"})
    html = sign_in_browser("ann", pilot="viewer").page("/dashboard/studies/pilot/foods", q="tart", list="foods-1")
    assert 'role="option" id="foods-1-1"' in html
    assert 'data-key="odd"' in html
    assert "<script>" not in html
