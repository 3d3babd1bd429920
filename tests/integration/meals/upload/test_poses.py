"""Known poses over HTTP: the metadata field is checked, kept and given to the estimate, of each pair its own."""

import copy

import pytest

from app.children.faults import JobFailure
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.meals.upload.measuring import estimate
from tests.integration.meals.upload.test_rigs import rig, send
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair
from tests.unit.vision.poses import arkit_poses
from tests.unit.vision.stereo_scene import blank_views

POSES = arkit_poses(*blank_views())
CAMERA = {"width": 640, "height": 480, "fx": 512.0, "fy": 512.0, "cx": 320.0, "cy": 240.0}


def changed(path, value):
    data = copy.deepcopy(POSES)
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return data


def test_pair_with_poses_needs_no_marker_and_a_single_photograph_does(enrol, state, settings):
    phone = enrol(marker=None)
    body = meal_metadata(poses=POSES, camera=CAMERA)
    assert phone.post(pair(), metadata=body).status_code == 202
    options = estimate(state, settings, body["id"]).options
    assert (options["marker"], options["rig"], options["camera"]["fx"]) == (None, None, 512.0)
    assert options["poses"]["views"] == POSES["views"]
    assert options["poses"]["convention"] == "arkit"
    alone = phone.post({"left": pair()["left"]}, metadata=meal_metadata(poses=POSES, views=1))
    assert refusal(alone) == (422, "marker_missing")


def test_marker_and_poses_both_reach_the_estimate_and_a_rig_that_is_named_leaves_poses_aside(phone, state, settings):
    body = meal_metadata(poses=POSES)
    phone.post(pair(), metadata=body)
    options = estimate(state, settings, body["id"]).options
    assert (options["marker"], options["poses"]["convention"]) == ("plain:9x7:11", "arkit")
    send(phone, **rig())
    by_hand, by_rig = meal_metadata(poses=POSES), meal_metadata(poses=POSES, rig=rig())
    for other in (by_hand, by_rig):
        phone.post(pair(), metadata=other)
    assert estimate(state, settings, by_hand["id"]).options["rig"] is None
    options = estimate(state, settings, by_rig["id"]).options
    assert (options["marker"], options["poses"]) == (None, None)
    assert options["rig"] is not None


def test_poses_that_cannot_be_are_refused_and_others_make_another_meal(phone):
    for data, code in (
        (changed(("convention",), "unity"), None),
        (changed(("views",), {"left": POSES["views"]["left"]}), None),
        (changed(("views", "left", 0, 3), 1e300), None),
        (changed(("views", "left", 0, 3), 60.0), "poses_invalid"),
        (POSES | {"gravity": [0.0, 0.0, 0.0]}, "poses_invalid"),
    ):
        answer = phone.post(pair(), metadata=meal_metadata(poses=data))
        assert answer.status_code == 422
        assert code in (None, answer.json()["code"])
    for text in (b'{"poses": NaN}', b'{"poses": ' + b"[" * 100_000, b'{"poses": [' + b"1.0," * 400_000 + b"1]}"):
        assert phone.post(pair(), metadata=text).status_code in (400, 413, 422)
    body = meal_metadata(poses=POSES, rig=rig())
    assert [phone.post(pair(), metadata=body).status_code for _ in range(2)] == [202, 200]
    for other in ({"poses": POSES | {"gravity": [0.0, -1.0, 0.0]}}, {"rig": rig(baseline=61.0)}):
        assert refusal(phone.post(pair(), metadata=body | other)) == (409, "meal_id_reused")


def test_after_meal_pair_has_poses_of_its_own_and_never_the_meals(enrol, state, settings):
    phone = enrol(marker=None, expects_after_pair=True)
    with_own, without = meal_metadata(poses=POSES), meal_metadata(poses=POSES)
    for body, poses in ((with_own, POSES | {"gravity": [0.0, -9.8, 0.0]}), (without, None)):
        phone.post(pair(), metadata=body)
        estimates.save(state, body["id"], found_item(hint=None), marker=None)
        after = {"captured_at": "2026-11-20T13:00:00+08:00"} | ({"poses": poses} if poses else {})
        assert phone.put(f"/v1/meals/{body['id']}/after", json=after).status_code == 202
        for slot, content in pair(1).items():
            phone.put(f"/v1/meals/{body['id']}/images/after_{slot}", content=content)
    options = estimate(state, settings, with_own["id"], purpose="after").options
    assert options["poses"]["gravity"] == [0.0, -1.0, 0.0]
    with pytest.raises(JobFailure) as raised:
        estimate(state, settings, without["id"], purpose="after")
    assert raised.value.failure.code == "scale_missing"
