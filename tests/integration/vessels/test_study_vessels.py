"""A study's vessel library over HTTP: kept by owners, read by staff and phones, named in hints, given to estimates."""

import csv
import io

import pytest
import sqlalchemy as sa

from app.meals.stored.models import Meal
from app.meals.stored.record_models import Run
from app.people.privacy_models import AuditEvent
from app.vessels.models import VESSEL_KINDS as KINDS_OF_TABLE
from app.vessels.models import StudyVesselVersion
from app.vision.vessel_library import MAX_VESSELS, VESSEL_KINDS, vessels_from_json
from tests.integration.conftest import meal_metadata
from tests.integration.foods.editing import refused
from tests.integration.meals.upload.measuring import estimate
from tests.integration.people.people import make_staff
from tests.support.photographs import pair

ROOT = "/v1/studies/pilot/vessels"
MUG = {"name": "Blue mug", "kind": "mug", "rim_diameter_mm": 82.0, "height_mm": 95.0, "capacity_ml": 400.0}
BOWL = {
    "name": "Cereal bowl",
    "kind": "bowl",
    "rim_diameter_mm": 150.0,
    "height_mm": 60.0,
    "inside_profile_mm": [[0.0, 8.0], [40.0, 10.0], [75.0, 60.0]],
}


@pytest.fixture
def owner(client, admin, phone):
    """The API as an owner of the phone's study uses it."""
    return make_staff(client, admin, "olga", pilot="owner")


@pytest.fixture
def given(state):
    """Estimate the newest meal; (what the child was asked, the parameters of the run that is saved)."""

    def run():
        with state.database.read() as session:
            meal = session.scalars(sa.select(Meal).order_by(Meal.received_at.desc())).first()
        children = estimate(state, state.settings, str(meal.client_id))
        with state.database.read() as session:
            newest = session.scalars(sa.select(Run).order_by(Run.created_at.desc())).first()
        return children.options, newest.parameters

    return run


def add(owner, vessel=MUG, **changes):
    made = owner.post(ROOT, json=vessel | changes)
    assert made.status_code == 201, made.text
    return made.json()


def put(owner, vessel, tag="*", **changes):
    body = {key: value for key, value in vessel.items() if key in MUG and key != "name"} | changes
    return owner.put(f"{ROOT}/{vessel['id']}", json=body, headers={"If-Match": tag} if tag else {})


def test_tables_kinds_are_the_pipelines_and_a_library_fits_one_page():
    assert KINDS_OF_TABLE == VESSEL_KINDS
    assert MAX_VESSELS <= 1000  # export_vessels reads one


def test_vessel_is_added_read_measured_anew_and_retired(owner):
    made = owner.post(ROOT, json=MUG)
    assert made.status_code == 201, made.text
    vessel = made.json()
    assert made.headers["etag"] == '"1"'
    assert made.headers["location"] == f"{ROOT}/{vessel['id']}"
    assert {key: vessel[key] for key in MUG} == MUG
    assert (vessel["author"], vessel["is_retired"], vessel["version"]) == ("staff: olga", False, 1)
    changed = put(owner, vessel, '"1"', capacity_ml=410.0)
    assert (changed.status_code, changed.json()["capacity_ml"], changed.headers["etag"]) == (200, 410.0, '"2"')
    assert owner.get(f"{ROOT}/{vessel['id']}?version=1").json() == vessel
    refused(owner.get(f"{ROOT}/{vessel['id']}?version=3"), 404, "vessel_not_found")
    assert owner.delete(f"{ROOT}/{vessel['id']}").status_code == 204
    assert owner.delete(f"{ROOT}/{vessel['id']}").status_code == 204
    retired = owner.get(f"{ROOT}/{vessel['id']}")
    assert (retired.json()["is_retired"], retired.json()["capacity_ml"], retired.headers["etag"]) == (
        True,
        410.0,
        '"3"',
    )
    again = put(owner, vessel, '"3"', capacity_ml=410.0).json()
    assert (again["is_retired"], again["version"]) == (False, 4)


def test_same_measures_make_no_version_and_a_change_of_an_older_version_is_refused(owner):
    vessel = add(owner)
    assert put(owner, vessel).json() == vessel
    assert put(owner, vessel, '"1"', capacity_ml=410.0).status_code == 200
    problem = refused(put(owner, vessel, '"1"', capacity_ml=420.0), 412, "precondition_failed")
    assert problem["version"] == 2
    refused(put(owner, vessel, None, capacity_ml=420.0), 428, "precondition_required")
    assert owner.get(f"{ROOT}/{vessel['id']}").json()["capacity_ml"] == 410.0


def test_name_is_unique_without_case_in_a_study_and_fixed(owner, client, admin):
    vessel = add(owner)
    refused(owner.post(ROOT, json=MUG | {"name": "  blue   MUG "}), 409, "vessel_exists")
    refused(put(owner, vessel, name="Red mug"), 409, "vessel_name_fixed")
    assert put(owner, vessel, name="blue mug").json()["name"] == "Blue mug"
    owner.delete(f"{ROOT}/{vessel['id']}")
    refused(owner.post(ROOT, json=MUG), 409, "vessel_exists")
    client.post("/v1/studies", headers=admin, json={"code": "second", "name": "second"})
    assert client.post("/v1/studies/second/vessels", headers=admin, json=MUG).status_code == 201


def test_vessel_of_another_study_is_not_found(owner, client, admin):
    vessel = add(owner)
    client.post("/v1/studies", headers=admin, json={"code": "second", "name": "second"})
    path = f"/v1/studies/second/vessels/{vessel['id']}"
    refused(client.get(path, headers=admin), 404, "vessel_not_found")
    refused(client.delete(path, headers=admin), 404, "vessel_not_found")
    body = {key: value for key, value in MUG.items() if key != "name"}
    refused(client.put(path, headers=admin | {"If-Match": "*"}, json=body), 404, "vessel_not_found")
    assert not owner.get(f"{ROOT}/{vessel['id']}").json()["is_retired"]


def test_list_is_by_name_in_pages_and_as_csv(owner):
    for name in ("cup b", "Cup A", "cup C"):
        add(owner, name=name)
    add(owner, BOWL)
    retired = owner.get(ROOT).json()["items"][1]
    owner.delete(f"{ROOT}/{retired['id']}")
    first = owner.get(f"{ROOT}?limit=2&is_in_use=true").json()
    second = owner.get(first["next"]).json()
    assert [row["name"] for row in first["items"] + second["items"]] == ["Cereal bowl", "cup b", "cup C"]
    assert second["next"] is None
    rows = list(csv.DictReader(io.StringIO(owner.get(f"{ROOT}?format=csv").text)))
    assert [(row["name"], row["is_retired"]) for row in rows][:2] == [("Cereal bowl", "False"), ("Cup A", "True")]


def test_phone_lists_the_vessels_in_use_without_who_measured_them(owner, phone):
    add(owner, BOWL)
    owner.delete(f"{ROOT}/{add(owner)['id']}")
    listed = phone.get("/v1/me/vessels").json()
    assert [row["name"] for row in listed["items"]] == ["Cereal bowl"]
    assert listed["items"][0]["inside_profile_mm"] == BOWL["inside_profile_mm"]
    assert "olga" not in phone.get("/v1/me/vessels").text


IMPOSSIBLE = [
    ({"capacity_ml": None}, "vessel_invalid"),
    ({"name": " \t "}, "vessel_invalid"),
    ({"name": "a\u202eb"}, "vessel_invalid"),
    ({"kind": "bucket"}, "invalid_input"),
    ({"rim_diameter_mm": 8.2}, "invalid_input"),
    ({"capacity_ml": 9.0}, "vessel_impossible"),
    ({"capacity_ml": 4000.0}, "vessel_impossible"),
    ({"inside_profile_mm": [[0, 5], [41, 95], [30, 60]]}, "vessel_invalid"),
    ({"inside_profile_mm": [[0, 5], [82, 95]]}, "vessel_impossible"),
    ({"inside_profile_mm": [[0, 0.5], [41, 9.5]]}, "vessel_impossible"),
    ({"inside_profile_mm": [[0, 5], [12, 5], [41, 95]]}, "vessel_impossible"),
    ({"inside_profile_mm": [[0, 5, 9], [41, 95, 9]]}, "invalid_input"),
    ({"inside_profile_mm": [[0, 5]] * 201}, "invalid_input"),
    ({"fill_line_mm": 70.0}, "vessel_invalid"),
    ({"fill_line_ml": 250.0}, "vessel_invalid"),
    ({"capacity_ml": None, "fill_line_mm": 99.0, "fill_line_ml": 250.0}, "vessel_impossible"),
    ({"capacity_ml": None, "fill_line_mm": 90.0, "fill_line_ml": 20.0}, "vessel_impossible"),
    ({"fill_line_mm": 70.0, "fill_line_ml": 401.0}, "vessel_impossible"),
    ({"fill_line_mm": 96.0, "fill_line_ml": 300.0}, "vessel_impossible"),
    ({"colour": "blue"}, "invalid_input"),
]


def test_vessel_that_cannot_be_is_refused(owner):
    for changes, code in IMPOSSIBLE:
        answered = owner.post(ROOT, json=MUG | changes)
        assert answered.status_code == 422, (changes, answered.text)
        assert answered.json()["code"] == code, changes
    assert owner.get(ROOT).json()["items"] == []


def test_capacity_follows_from_the_fill_line(owner, given, phone):
    vessel = add(owner, capacity_ml=None, fill_line_mm=75.0, fill_line_ml=300.0)
    assert (vessel["capacity_ml"], vessel["fill_line_mm"], vessel["fill_line_ml"]) == (None, 75.0, 300.0)
    phone.post(pair())
    options, _ = given()
    assert 380.0 < options["vessels"][0]["capacity_ml"] < 420.0  # 300 ml and 20 mm of about 41 mm radius


def test_library_beyond_its_limit_is_refused(owner, monkeypatch):
    monkeypatch.setattr("app.vessels.study_vessels.MAX_VESSELS", 2)
    vessel = add(owner)
    add(owner, BOWL)
    assert refused(owner.post(ROOT, json=MUG | {"name": "third"}), 409, "vessels_too_many")["limit"] == 2
    owner.delete(f"{ROOT}/{vessel['id']}")
    add(owner, name="third")
    refused(put(owner, vessel), 409, "vessels_too_many")


def test_estimate_is_given_the_vessels_in_use_and_the_run_keeps_their_versions_if_there_are_any(owner, phone, given):
    phone.post(pair())
    options, parameters = given()
    assert options["vessels"] == []
    assert "vessels" not in parameters
    vessel = add(owner)
    put(owner, vessel, capacity_ml=410.0)
    add(owner, BOWL)
    owner.delete(f"{ROOT}/{add(owner, name='Old cup')['id']}")
    phone.post(pair())
    options, parameters = given()
    names = [model.name for model in vessels_from_json(options["vessels"])]
    assert names == ["Blue mug", "Cereal bowl"]
    assert options["vessels"][0]["capacity_ml"] == 410.0
    assert parameters["vessels"] == {"Blue mug": 2, "Cereal bowl": 1}


def test_hint_names_a_vessel_without_case_and_a_retired_one_still_counts(owner, phone, given):
    owner.delete(f"{ROOT}/{add(owner)['id']}")
    sent = phone.post(pair(), hints=[{"point": [5, 5], "food": "milk-whole", "vessel": "blue MUG"}])
    assert sent.status_code == 202, sent.text
    options, parameters = given()
    assert options["hints"][0]["vessel"] == "Blue mug"
    assert [vessel["name"] for vessel in options["vessels"]] == ["Blue mug"]
    assert parameters["vessels"] == {"Blue mug": 2}


def test_hint_with_a_vessel_that_the_study_has_not_is_refused_and_nothing_is_kept(owner, phone, state):
    add(owner)
    problem = refused(phone.post(pair(), hints=[{"point": [5, 5], "vessel": "Red mug"}]), 422, "vessel_unknown")
    assert problem["vessels"] == ["Red mug"]
    body = meal_metadata(hints=[{"food": "milk", "vessel": "Red mug"}])
    refused(phone.put(f"/v1/meals/{body.pop('id')}", json=body), 422, "vessel_unknown")
    with state.database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Meal)) == 0
    meal_id = phone.post(pair()).json()["id"]
    body = {"captured_at": meal_metadata()["captured_at"], "hints": [{"point": [5, 5], "vessel": "Red mug"}]}
    refused(phone.put(f"/v1/meals/{meal_id}/after", json=body), 422, "vessel_unknown")
    body["hints"][0]["vessel"] = "Blue mug"
    assert phone.put(f"/v1/meals/{meal_id}/after", json=body).status_code == 202


@pytest.mark.both_stores
def test_each_change_is_in_the_audit_log_without_the_name(owner, state):
    vessel = add(owner)
    put(owner, vessel, capacity_ml=410.0)
    owner.delete(f"{ROOT}/{vessel['id']}")
    with state.database.read() as session:
        query = sa.select(AuditEvent).where(AuditEvent.action.startswith("vessel.")).order_by(AuditEvent.id)
        events = list(session.scalars(query))
        versions = session.scalar(sa.select(sa.func.count()).select_from(StudyVesselVersion))
    assert [event.action for event in events] == ["vessel.add", "vessel.change", "vessel.retire"]
    assert {event.subject for event in events} == {vessel["id"]}
    assert "mug" not in str([event.details for event in events]).lower()
    assert versions == 3
