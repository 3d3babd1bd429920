"""Stereo rigs over HTTP: kept per phone, model and study; a meal by one needs no marker and its run names the rig."""

import json

import pytest

from app.children.faults import JobFailure
from app.meals.estimate.run_estimate import estimate_task
from app.people.models import Device
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.meals.upload.measuring import estimate
from tests.support.photographs import pair

DISTORTION = [0.05, -0.1, 0.0, 0.0, 0.0]


def rig(focal=512.0, width=640, height=480, baseline=60.0, **changes):
    """A rig file as `tada calibrate --rig --json` prints it."""
    camera = {"width": width, "height": height, "fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2}
    camera |= {"distortion": DISTORTION, "source": "given"}
    pose = {"R": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "t_mm": [-baseline, 0.0, 0.0]}
    return {"left": camera, "right": camera} | pose | {"baseline_mm": baseline, "rms_px": 0.21, "pairs": 9} | changes


def send(phone, **body):
    return phone.client.post("/v1/rigs", headers=phone.headers, json=body)


@pytest.fixture
def no_marker(enrol):
    """A phone of a study that gives out no marker."""
    return enrol(marker=None)


def set_model(state, model):
    with state.database.write() as session:
        session.query(Device).update({"model": model})


def test_meal_by_the_phones_rig_needs_no_marker_and_its_run_names_the_rig(no_marker, state, settings, client, admin):
    assert refusal(no_marker.post(pair(), metadata=meal_metadata())) == (422, "marker_missing")
    kept = send(no_marker, **rig()).json()
    assert (kept["kind"], kept["marker"], kept["rms_px"], kept["photographs"]) == ("rig", None, 0.21, 9)
    assert kept["rig"]["t_mm"] == [-60.0, 0.0, 0.0]
    assert no_marker.get("/v1/calibrations").json()["items"] == [kept]
    body = meal_metadata()
    assert no_marker.post(pair(), metadata=body).status_code == 202
    options = estimate(state, settings, body["id"]).options
    assert (options["marker"], options["camera"]) == (None, None)
    assert options["rig"]["left"]["fx"] == 512.0
    run = no_marker.get(f"/v1/meals/{body['id']}").json()["run"]
    assert run["marker"] is None
    assert (run["parameters"]["camera_from"], run["parameters"]["rig"]["t_mm"]) == ("device", [-60.0, 0.0, 0.0])
    assert run["camera"]["right"]["calibrations"] == [kept["id"]]
    rows = client.get("/v1/meals?study=pilot&format=ndjson", headers=admin)
    assert [json.loads(line)["marker"] for line in rows.text.splitlines()] == [None]


def test_rig_is_chosen_from_meal_phone_model_and_study_in_this_order(no_marker, state, settings, client, admin):
    set_model(state, "Twin 3")

    def chosen(**metadata):
        body = meal_metadata(**metadata)
        assert no_marker.post(pair(), metadata=body).status_code == 202
        return estimate(state, settings, body["id"]).options["rig"]["left"]["fx"]

    def of_study(focal, **model):
        path = "/v1/studies/pilot/rigs"
        return client.post(path, headers=admin, json=rig(focal), params=model)

    assert of_study(501.0).status_code == 201
    assert of_study(502.0, model="Twin 4").status_code == 201
    assert chosen() == 501.0
    of_model = of_study(503.0, model="Twin 3").json()
    assert chosen() == 503.0
    own = send(no_marker, **rig(504.0)).json()
    assert chosen() == 504.0
    assert chosen(rig=rig(505.0)) == 505.0
    for kept in (own, of_model):
        path = f"/v1/calibrations/{kept['id']}/withdrawal"
        assert client.post(path, headers=admin).json()["withdrawn_at"] is not None
    assert chosen() == 501.0
    listed = client.get("/v1/studies/pilot/calibrations", headers=admin).json()["items"]
    assert [(each["participant"], each["model"], each["rig"]["left"]["fx"]) for each in listed] == [
        ("P001", "Twin 3", 504.0),
        (None, "Twin 3", 503.0),
        (None, "Twin 4", 502.0),
        (None, None, 501.0),
    ]


def test_more_rigs_of_a_study_than_the_limit_are_refused(client, phone, enrol, admin, monkeypatch):
    monkeypatch.setattr("app.people.calibrate_device.MAX_STUDY_RIGS", 2)
    other = enrol("P009", "second")
    path = "/v1/studies/{}/rigs"
    first, _ = (client.post(path.format("pilot"), headers=admin, json=rig()).json()["id"] for _ in range(2))
    refused = client.post(path.format("pilot"), headers=admin, json=rig())
    assert (*refusal(refused), refused.json()["limit"]) == (409, "rigs_too_many", 2)
    assert client.post(path.format("second"), headers=admin, json=rig()).status_code == 201
    assert send(other, **rig()).status_code == 201  # a phone's own does not count
    assert client.post(f"/v1/calibrations/{first}/withdrawal", headers=admin).status_code == 200
    assert client.post(path.format("pilot"), headers=admin, json=rig()).status_code == 201


def test_marker_of_the_meal_or_another_picture_size_leaves_a_stored_rig_aside(phone, state, settings):
    send(phone, **rig())
    for metadata, size in (({"marker": "plain:9x7:11"}, (640, 480)), ({}, (480, 640)), ({"views": 1}, (640, 480))):
        body = meal_metadata(**metadata)
        photos = {"left": pair(size=size)["left"]} if "views" in metadata else pair(size=size)
        assert phone.post(photos, metadata=body).status_code == 202
        options = estimate(state, settings, body["id"]).options
        assert (options["rig"], options["camera"], options["marker"]) == (None, None, "plain:9x7:11")


def test_rig_serves_no_older_meal_beside_the_studys_marker_and_none_that_names_its_camera(phone, state, settings):
    older = meal_metadata()
    assert phone.post(pair(), metadata=older).status_code == 202
    send(phone, **rig())
    camera = {"width": 640, "height": 480, "fx": 520.0, "fy": 520.0, "cx": 320.0, "cy": 240.0}
    own, later = meal_metadata(camera=camera), meal_metadata()
    for body in (own, later):
        assert phone.post(pair(), metadata=body).status_code == 202
    rigs = [estimate(state, settings, body["id"]).options["rig"] for body in (older, own, later)]
    assert [each is not None for each in rigs] == [False, False, True]


def test_meal_without_its_withdrawn_rig_is_the_same_and_fails_and_one_of_another_size_is_a_mismatch(
    no_marker, state, settings
):
    kept = send(no_marker, **rig()).json()
    withdrawn, other = meal_metadata(), meal_metadata()
    assert no_marker.post(pair(), metadata=withdrawn).status_code == 202
    assert no_marker.post(pair(size=(480, 640)), metadata=other).status_code == 202
    estimate(state, settings, other["id"], run=estimate_task)
    assert no_marker.get(f"/v1/meals/{other['id']}").json()["failure"]["code"] == "camera_mismatch"
    no_marker.client.post(f"/v1/calibrations/{kept['id']}/withdrawal", headers=no_marker.headers)
    assert no_marker.post(pair(), metadata=withdrawn).status_code == 200
    assert refusal(no_marker.post(pair(), metadata=meal_metadata())) == (422, "marker_missing")
    with pytest.raises(JobFailure) as raised:
        estimate(state, settings, withdrawn["id"])
    assert raised.value.failure.code == "scale_missing"


def test_rig_that_cannot_be_is_refused_everywhere(phone, client, admin):
    for changes, code in (
        ({"R": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]}, "rig_invalid"),  # a mirror
        ({"R": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]}, None),
        ({"t_mm": [0.0, 0.0, 60.0]}, "rig_invalid"),  # one camera behind the other
        ({"t_mm": [-60.0, 0.0, 1e300]}, None),
        ({"left": {"width": 640, "height": 480, "fx": 1.0, "fy": 1.0, "cx": 320.0, "cy": 240.0}}, "camera_invalid"),
        ({"left": None}, None),
    ):
        body = rig(**changes)
        sent = [
            send(phone, **body),
            client.post("/v1/studies/pilot/rigs", headers=admin, json=body),
            phone.post(pair(), metadata=meal_metadata(rig=body)),
        ]
        assert [each.status_code for each in sent] == [422] * 3, changes
        assert code is None or {each.json()["code"] for each in sent} == {code}
    poor = rig(rms_px=50.0)
    sent = send(phone, **poor), client.post("/v1/studies/pilot/rigs", headers=admin, json=poor)
    assert [refusal(each) for each in sent] == [(422, "calibration_poor")] * 2
    for changes in ({"marker": "plain:9x7:11"}, {"views": 3}, {"camera": {"fx": 1.0}}):
        assert phone.post(pair(), metadata=meal_metadata(rig=rig(), **changes)).status_code == 422
    assert phone.get("/v1/calibrations").json()["items"] == []
    camera = {"fx": 512.0, "fy": 512.0, "cx": 320.0, "cy": 240.0, "distortion": DISTORTION}
    both = {"left": camera, "right": camera, "width": 640, "height": 480}  # one size for both is allowed
    kept = send(phone, **(rig() | both)).json()
    assert [kept["rig"][side]["width"] for side in ("left", "right")] == [640, 640]
