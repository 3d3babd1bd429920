"""The page of a meal: the API's figures, escaped text of people, controls by role."""

import re
import uuid
from pathlib import Path

import pytest
import sqlalchemy as sa

import app.dashboard
from app.dashboard.meal_pages.flag_words import FLAGS
from app.people.access.page_rules import MEAL, POLLED
from app.people.privacy_models import AuditEvent
from tests.integration.conftest import meal_metadata
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.support import estimates
from tests.support.estimates import found_item, identified_item, unmeasured_item
from tests.support.photographs import pair

NO_COLOUR = {"kind": "none", "matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "delta_e_mean": None, "flags": []}
NO_COLOUR |= {"delta_e_worst": None}
CAMERA = {"width": 1200, "height": 900, "fx": 900.0, "fy": 900.0, "cx": 600.0, "cy": 450.0, "distortion": [0.0] * 5}
JSON = {"Accept": "application/json"}
DOCS = Path(app.dashboard.__file__).parents[2] / "docs"


class Shown:
    """A meal by its page and by the API."""

    def __init__(self, phone, browser, meal_id):
        self.phone, self.browser, self.id = phone, browser, meal_id
        self.path = f"/dashboard/studies/pilot/meals/P001/{meal_id}"

    def html(self):
        return self.browser.page(self.path)

    def meal(self):
        return self.phone.get(f"/v1/meals/{self.id}").json()

    def say(self, kind, *, headers=None, **fields):
        meal = self.meal()
        form = {"id": str(uuid.uuid4()), "kind": kind, "version": meal["version"]}
        if meal["items"]:
            form["item"] = meal["items"][0]["id"]
        return self.browser.post(f"{self.path}/events", headers=headers, **(form | fields))

    def history(self):
        return self.phone.get(f"/v1/meals/{self.id}/events").json()["items"]


@pytest.fixture
def show(phone, meal_of, sign_in_browser):
    """A meal of P001, estimated as said, as somebody sees it: show("reviewer", found_item())."""
    browsers = {}

    def make(role, *items, **changes):
        meal_id = meal_of(*items, **changes)
        if role not in browsers:
            browsers[role] = sign_in_browser(f"ann-{role}", pilot=role)
        return Shown(phone, browsers[role], meal_id)

    return make


def numbers_of(value):
    """All numbers of an item as the API gives it, but where its outline is."""
    if isinstance(value, dict):
        return [n for key, one in value.items() if key != "polygon" for n in numbers_of(one)]
    if isinstance(value, list):
        return [n for one in value for n in numbers_of(one)]
    return [float(value)] if isinstance(value, int | float) and not isinstance(value, bool) else []


def test_every_figure_of_the_api_is_on_the_page_unrounded_and_its_json_is_the_apis(show):
    seen = show("viewer", identified_item({"pear": 0.62, "apple": 0.3}, none=0.08, hint=0), unmeasured_item(hint=None))
    meal, figures = seen.meal(), set(figures_of(seen.html()))
    expected = numbers_of(meal["items"]) + numbers_of(meal["totals"])
    assert len(expected) > 100
    missing = [number for number in expected if number not in figures and number != meal["totals"]["unmeasured_items"]]
    assert missing == []
    assert set(meal["run"]["stages"].values()) <= figures
    assert "The mass of 1 item is unknown" in text_of(seen.html())
    assert seen.browser.get(seen.path, format="json").json() == meal


def test_run_is_described_by_its_photographs_and_by_what_gave_the_scale(show):
    stages = {"read": 0.1, "marker": 0.1, "camera": 0.1}
    single = {"views": 1, "camera_height_first_mm": 301.5}
    colour = {"left": NO_COLOUR, "right": NO_COLOUR}
    item = found_item(flags=["single_view"])
    text = text_of(show("viewer", item, parameters=single, camera=CAMERA, colour=colour, stages=stages).html())
    assert "Found in the left photograph" in text
    assert "Camera above the table 302 mm" in text
    for source, words in (("poses", "cameras&#39; poses"), ("depth", "depth map")):
        text = text_of(show("viewer", found_item(), parameters={"scale_source": source}, stages=stages).html())
        assert f"Scale {words}" in text
        assert "Found not where it was needed" in text
    # of more than two photographs another one than the right one may be the left one's partner
    colour = {"left": NO_COLOUR, "view3": NO_COLOUR | {"kind": "white"}}
    cameras = {"camera": CAMERA, "camera_right": CAMERA | {"fx": 901.0}}
    shown = show("viewer", found_item(), colour=colour, **cameras, second="view3")
    text = text_of(shown.html())
    assert "Colours, view3 white balance" in text
    assert "Camera, view3 focal length 901 px" in text
    assert set(shown.meal()["run"]["camera"]) == {"left", "view3"}


def test_history_shows_runs_and_events_with_old_and_new_values(show):
    seen = show("reviewer", found_item(volume_ml=185.0))
    seen.say("set_volume", volume_ml="120")
    seen.say("question", text="Was it yours?")
    event = seen.history()[0]
    seen.say("undo", event=event["id"], item="")
    text = text_of(seen.html())
    assert "Estimate of the meal" in text
    assert re.search(r"Volume .{0,80}ann-reviewer .{0,40}taken back .{0,30}185 ml → 120 ml", text), text[-3000:]
    assert "Was it yours?" in text
    assert "Taken back" in text
    assert seen.meal()["items"][0]["volume_ml"] == 185.0


def test_conflict_shows_what_changed_and_lets_the_reviewer_repeat_the_event(show, sign_in_browser):
    ann = show("reviewer", found_item())
    seen = ann.meal()["version"]
    bob = Shown(ann.phone, sign_in_browser("bob", pilot="reviewer"), ann.id)
    assert bob.say("set_food", food="pear").status_code == 303
    for headers in ({"HX-Request": "true"}, None):
        answer = ann.say("set_mass", version=seen, mass_g="150", headers=headers)
        assert answer.status_code == 412
        assert ("<!doctype html>" in answer.text) is (headers is None)
        notice = text_of(answer.text[answer.text.index('id="conflict"') :])[:900]
        assert re.search(r"Food .{0,40}bob .{0,60}Apple, raw, with skin → .{0,20}Pear", notice), notice
        assert "You wanted: Mass , grams 150" in notice
    assert ann.meal()["items"][0]["food"]["key"] == "pear"
    again = dict(re.findall(r'name="(\w+)" value="([^"]*)"', answer.text.split('id="conflict"')[1].split("</form>")[0]))
    assert ann.browser.post(f"{ann.path}/events", **again).status_code == 303
    item = ann.meal()["items"][0]
    assert (item["food"]["key"], item["mass_g"]) == ("pear", 150.0)


def test_amount_that_can_hardly_be_is_asked_about_once(show):
    ann = show("reviewer", found_item())
    before = ann.meal()
    for headers in ({"HX-Request": "true"}, None):
        answer = ann.say("set_mass", mass_g="15000", headers=headers)
        assert answer.status_code == 422
        assert "Is that right?" in text_of(answer.text[answer.text.index('id="conflict"') :])
    assert ann.meal() == before
    again = dict(re.findall(r'name="(\w+)" value="([^"]*)"', answer.text.split('id="conflict"')[1].split("</form>")[0]))
    assert ann.browser.post(f"{ann.path}/events", **again).status_code == 303
    item = ann.meal()["items"][0]
    assert (item["mass_g"], "implausible_amount" in item["flags"]) == (15000, True)


def test_form_makes_the_same_event_as_the_api(show):
    reviewed = show("reviewer", found_item(hint=0))
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
        answer = reviewed.say(said, headers=JSON, **fields)
        assert answer.status_code == 201, answer.text
        assert answer.json()["version"] == reviewed.meal()["version"]
        assert answer.headers["etag"] == f'"{reviewed.meal()["version"]}"'
        event = reviewed.history()[-1]
        assert (event["kind"], event["layer"]) == (said, "reviewer")
        assert event["new"].items() >= new.items()


def test_impossible_value_is_refused_with_a_sentence_and_changes_nothing(show):
    reviewed = show("reviewer", found_item(hint=0))
    before = reviewed.meal()
    for said, fields, words in (
        ("set_mass", {"mass_g": "-5"}, "Grams: This must be 0.001 or more."),
        ("set_mass", {}, "give one of"),
        ("set_volume", {"volume_ml": "nan"}, "Millilitres: "),
        ("redraw", {"polygon": "[" * 5000}, "Outline: "),
        ("redraw", {"polygon": "1,1\n2,2"}, "Outline: "),
        ("comment", {"text": "   "}, "text"),
        ("answer", {"item": "", "text": "yes"}, "This event is not possible"),
        ("confirm", {"mass_g": "1"}, "Grams: This field is not allowed here."),
    ):
        answer = reviewed.say(said, headers=JSON, **fields)
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), answer.text
        assert words.lower() in answer.json()["detail"].lower()
    assert reviewed.meal() == before


def test_meal_is_found_only_below_its_study_and_its_participant(enrol, sign_in_browser):
    phones = {study: enrol("P001", study=study) for study in ("pilot", "second")}
    enrol("P002")
    meal = phones["second"].post(pair(3)).json()["id"]
    ann = sign_in_browser("ann", pilot="owner", second="owner")
    own = f"/dashboard/studies/second/meals/P001/{meal}"
    version = phones["second"].get(f"/v1/meals/{meal}").json()["version"]
    event = {"id": str(uuid.uuid4()), "kind": "comment", "text": "x", "version": version}
    for place in (f"pilot/meals/P001/{meal}", f"second/meals/P002/{meal}", f"second/meals/P001/{uuid.uuid4()}"):
        path = f"/dashboard/studies/{place}"
        assert ann.get(path).status_code == 404, path
        assert ann.post(f"{path}/events", **event).status_code == 404
        assert ann.post(f"{path}/erasure", typed="P001").status_code == 404
    assert ann.get(own).status_code == 200
    assert ann.post(f"{own}/events", **event).status_code == 303


def test_meal_is_erased_only_if_its_participants_code_was_entered(show):
    seen = show("owner", found_item())
    answer = seen.browser.post(f"{seen.path}/erasure", typed="P002")
    assert (answer.status_code, "Nothing was erased" in answer.text) == (422, True)
    assert seen.meal()["status"] == "estimated"
    answer = seen.browser.post(f"{seen.path}/erasure", typed="P001")
    assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard/studies/pilot/meals")
    assert seen.browser.get(seen.path).status_code == 404


def test_photograph_is_audited_and_not_sent_again_to_a_browser_that_has_it(state, show):
    seen = show("viewer", found_item())

    def readings():
        with state.database.read() as session:
            noted = sa.select(sa.func.count()).where(AuditEvent.action == "photograph.read")
            return session.scalar(noted)

    answer = seen.browser.get(f"{seen.path}/images/left", width=64)
    assert (answer.status_code, answer.headers["content-type"], readings()) == (200, "image/jpeg", 1)
    tag = {"If-None-Match": answer.headers["etag"]}
    assert seen.browser.get(f"{seen.path}/images/left", headers=tag, width=64).status_code == 304
    assert readings() == 1
    assert seen.browser.get(f"{seen.path}/images/attic").status_code == 422
    assert seen.browser.get(f"{seen.path}/artefacts/points.jpg").status_code == 404


def test_page_follows_a_meal_until_it_is_estimated_and_keeps_no_session_alive_by_it(state, show):
    seen = show("viewer")
    assert f'hx-get="{seen.path}/state"' in seen.html()
    polled = seen.browser.get(f"{seen.path}/state", headers={"HX-Request": "true"})
    assert (polled.status_code, "queued" in polled.text, "hx-get" in polled.text) == (200, True, True)
    assert ("GET", f"{MEAL}/state") in POLLED
    estimates.save(state, seen.id, found_item())
    polled = seen.browser.get(f"{seen.path}/state", headers={"HX-Request": "true"})
    assert (polled.status_code, polled.headers["hx-retarget"]) == (200, "#meal")
    assert "status-estimated" in polled.text
    assert "/state" not in polled.text
    assert "/state" not in seen.html()


def test_failed_meal_shows_reason_and_advice_and_a_reviewer_can_retry_it(show):
    failure = {"code": "marker_not_found", "message": "The marker was not found.", "advice": "Lay it flat."}
    seen = show("reviewer", failure=failure)
    text = text_of(seen.html())
    assert "The marker was not found. Lay it flat." in text
    assert "marker_not_found" in text
    answer = seen.browser.post(f"{seen.path}/retry")
    assert (answer.status_code, answer.headers["location"]) == (303, seen.path)
    assert seen.meal()["status"] == "queued"
    assert seen.browser.post(f"{seen.path}/cancel").status_code == 303
    assert seen.meal()["failure"]["code"] == "cancelled"


def test_page_says_first_why_the_meal_is_doubtful_by_cause(show):
    items = found_item(flags=["support_not_measured"]), unmeasured_item(hint=None)
    page = show("viewer", *items, parameters={"plausible_scale_factor": 0.5}).html()
    why = text_of(page[page.index('id="why"') : page.index('<dl class="figures">')])
    assert FLAGS["support_not_measured"] in why
    assert "The eaten amount is unknown. 2" in why
    assert "With all lengths times 0.5 they would be usual" in why


def test_text_entry_and_incomplete_meal_have_pages(client, phone, sign_in_browser):
    ann = sign_in_browser("ann", pilot="reviewer")
    told = meal_metadata(items=[{"food": "apple"}])
    assert client.post("/v1/declared-meals", headers=phone.headers, json=told).status_code == 201
    assert "entered as text" in ann.page(f"/dashboard/studies/pilot/meals/P001/{told['id']}")
    half = meal_metadata()
    body = {key: value for key, value in half.items() if key != "id"}
    assert phone.put(f"/v1/meals/{half['id']}", json=body).status_code == 202
    page = ann.page(f"/dashboard/studies/pilot/meals/P001/{half['id']}")
    assert text_of(page).count("This photograph has not arrived.") == 2


def test_every_flag_of_the_docs_is_explained():
    told = {
        flag
        for name in ("flags.md", "after-meal.md", "review.md")
        for cell in re.findall(r"^\| ((?:`[a-z_]+`(?:, )?)+) \|", (DOCS / name).read_text(), re.MULTILINE)
        for flag in re.findall(r"`([a-z_]+)`", cell)
    }
    kinds = {"confirm", "reject", "split", "merge", "add", "declare", "undo", "comment", "question", "answer"}
    kinds |= {"redraw", "reshape"}
    flags = {flag for flag in told if not flag.startswith(("set_", "confirm", "nothing"))} - kinds
    assert len(flags) > 20
    assert flags <= set(FLAGS)
