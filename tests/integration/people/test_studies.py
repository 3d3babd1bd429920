"""A study's protocol: made, read, changed under the version that was read, each change in the audit log."""

import pytest

from app.people.privacy_models import AuditEvent
from tests.integration.people.people import make_staff
from tests.support.photographs import pair

CAMERA = {"width": 4000, "height": 3000, "fx": 3000.0, "fy": 3000.0, "cx": 2000.0, "cy": 1500.0}


@pytest.fixture
def owner(client, admin):
    client.post("/v1/studies", headers=admin, json={"code": "pilot", "name": "Pilot"})
    return make_staff(client, admin, "olga", pilot="owner")


def change(owner, tag='"1"', **body):
    return owner.patch("/v1/studies/pilot", headers={"If-Match": tag}, json=body)


def audit(state, action):
    with state.database.read() as session:
        return [row.details for row in session.query(AuditEvent).filter_by(action=action).order_by(AuditEvent.id)]


def test_new_study_has_the_safe_defaults_and_keeps_every_setting(client, admin):
    made = client.post("/v1/studies", headers=admin, json={"code": "s", "name": "S"})
    assert made.status_code == 201
    assert made.headers["location"] == "/v1/studies/s"
    assert made.headers["etag"] == '"1"'
    body = made.json()
    assert (body["location_policy"], body["withdrawal_policy"], body["gives_feedback"]) == ("drop", "erase", False)
    assert (body["day_starts"], body["after_window_minutes"], body["locale"]) == ("00:00", 240, "en")
    assert body["shares_index"] is False
    assert client.get("/v1/studies/s", headers=admin).json() == body
    settings = {
        "marker": "colour:4x5:12",
        "camera": CAMERA,
        "expects_after_pair": True,
        "after_window_minutes": 90,
        "location_policy": "round",
        "location_decimals": 2,
        "retention_days": 30,
        "withdrawal_policy": "anonymise",
        "locale": "zh",
        "gives_feedback": True,
        "day_starts": "04:30",
        "shares_index": True,
    }
    client.post("/v1/studies", headers=admin, json={"code": "t", "name": "T"} | settings)
    kept = client.get("/v1/studies/t", headers=admin).json()
    assert {key: kept[key] for key in settings} == settings | {"camera": CAMERA | {"distortion": [0.0] * 5}}


def test_owner_changes_what_is_named_and_nothing_else(owner, state):
    assert change(owner, name="Pilot").headers["etag"] == '"1"'  # changes nothing
    changed = change(owner, name="Other", day_starts="04:00")
    assert (changed.status_code, changed.headers["etag"]) == (200, '"2"')
    body = changed.json()
    assert (body["name"], body["day_starts"], body["marker"], body["version"]) == ("Other", "04:00", None, 2)
    assert change(owner, '"2"', shares_index=True).json()["shares_index"] is True
    assert change(owner, '"3"', shares_index=False).json()["shares_index"] is False
    fields = ["day_starts_minutes", "name"], ["shares_index"], ["shares_index"]
    expected = [{"fields": names, "version": version} for version, names in enumerate(fields, 2)]
    assert audit(state, "study.change") == expected


def test_change_without_the_version_read_is_428_and_of_an_old_one_412(owner):
    assert owner.patch("/v1/studies/pilot", json={"name": "x"}).status_code == 428
    change(owner, name="Other")
    late = change(owner, name="Late")
    assert (late.status_code, late.json()["code"], late.json()["version"]) == (412, "precondition_failed", 2)


def test_null_takes_marker_camera_and_retention_away_and_decimals_go_with_the_rounding(owner):
    rounding = {"location_policy": "round", "location_decimals": 3}
    change(owner, marker="plain:9x7:11", camera=CAMERA, retention_days=9, **rounding)
    body = change(owner, '"2"', marker=None, camera=None, retention_days=None, location_policy="keep").json()
    names = ("marker", "camera", "retention_days", "location_decimals")
    assert [body[name] for name in names] == [None] * 4


def test_protocol_that_cannot_be_is_refused_and_nothing_changes(owner):
    for wrong in (
        {"marker": "plain:1x1:11"},
        {"location_policy": "round"},
        {"location_decimals": 2},
        {"location_policy": "round", "location_decimals": 5},
        {"day_starts": "12:01"},
        {"retention_days": 0},
        {"locale": "fr"},
        {"name": None},
        {"name": ""},
        {"expects_after_pair": None},
        {"code": "other"},
        {"camera": {"width": 0}},
    ):
        assert change(owner, **wrong).status_code == 422, wrong
    assert owner.get("/v1/studies/pilot").headers["etag"] == '"1"'


def test_day_start_is_fixed_once_a_meal_is_in(enrol, client, admin):
    phone = enrol()
    assert phone.post(pair()).status_code == 202
    tag = client.get("/v1/studies/pilot", headers=admin).headers["etag"]
    fixed = client.patch("/v1/studies/pilot", headers=admin | {"If-Match": tag}, json={"day_starts": "03:00"})
    assert (fixed.status_code, fixed.json()["code"]) == (409, "day_start_fixed")
    same = client.patch("/v1/studies/pilot", headers=admin | {"If-Match": tag}, json={"day_starts": "00:00"})
    assert same.status_code == 200


def test_studies_page_by_code_and_show_only_ones_own(client, admin, owner):
    for code in ("a", "b", "c"):
        client.post("/v1/studies", headers=admin, json={"code": code, "name": code})
    first = client.get("/v1/studies?limit=3", headers=admin).json()
    assert [study["code"] for study in first["items"]] == ["a", "b", "c"]
    second = client.get(first["next"], headers=admin).json()
    assert ([study["code"] for study in second["items"]], second["next"]) == (["pilot"], None)
    assert [study["code"] for study in owner.get("/v1/studies").json()["items"]] == ["pilot"]
    assert client.get("/v1/studies?cursor=nonsense", headers=admin).json()["code"] == "cursor_invalid"
