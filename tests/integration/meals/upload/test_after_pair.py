"""An after-meal pair comes in: slots, words about it, idempotency, its own status."""

import json
import uuid

import pytest

from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import Run
from app.people.privacy_models import BlobDeletion
from tests.integration.meals.upload.answers import refusal
from tests.integration.records.after_pairs import Table, left_of_apple
from tests.integration.records.at_once import at_once
from tests.support import estimates
from tests.support.photographs import photograph

FAILURE = {"code": "marker_not_found", "message": "No board.", "advice": "Put it beside the plate."}


@pytest.fixture
def table(phone, state):
    return Table(phone, state)


def jobs_for(state, purpose):
    with state.database.read() as session:
        return session.query(Job).filter(Job.purpose == purpose).all()


def test_pair_is_queued_with_its_second_photograph_and_the_meal_stays_as_it_is(table, state):
    before = table.measured().get()
    assert before["after"] is None
    first = table.put("after_left").json()
    assert (first["status"], first["after"]["status"]) == (before["status"], "receiving")
    assert first["after"]["missing"] == ["after_right"]
    assert jobs_for(state, "after") == []
    second = table.put("after_right").json()
    assert (second["status"], second["after"]["status"], second["after"]["missing"]) == (before["status"], "queued", [])
    assert before["version"] < first["version"] < second["version"]
    assert len(jobs_for(state, "after")) == 1
    assert set(second["after"]["images"]) == {"after_left", "after_right"}
    assert set(second["images"]) == {"left", "right"}


def test_pair_of_a_waiting_meal_is_queued_once_and_other_bytes_are_refused(table, state):
    meal = table.send_after().get()
    assert (meal["status"], meal["after"]["status"]) == ("queued", "queued")
    blobs = {blob.key for blob in state.blobs.keys("")}
    again = table.put("after_left")
    assert (again.status_code, again.headers["etag"]) == (200, f'"{meal["version"]}"')
    other = table.put("after_left", seed=99)
    assert (*refusal(other), other.json()["slot"]) == (409, "after_pair_differs", "after_left")
    assert {blob.key for blob in state.blobs.keys("")} == blobs
    assert len(jobs_for(state, "meal")) == len(jobs_for(state, "after")) == 1
    assert refusal(table.tell()) == (409, "after_pair_queued")


def test_metadata_of_the_pair_are_replaced_until_a_photograph_is_here(table, state):
    item = str(uuid.uuid4())
    told = {"hints": [{"point": [5, 6], "item": item, "class": "refuse"}]}
    assert [table.tell(**told).status_code for _ in range(2)] == [202, 200]
    assert table.after["captured_at"] == "2026-11-20T12:55:00+08:00"
    with state.database.read() as session:
        meal = session.query(Meal).one()
        assert meal.after_details["hints"] == [{"point": [5.0, 6.0], "item": item, "class": "refuse"}]
        assert meal.after_details["time_zone"] == "Asia/Shanghai"
    assert table.tell(**told, captured_at="2026-11-20T12:57:00+08:00").status_code == 202  # photographed anew
    assert table.after["captured_at"] == "2026-11-20T12:57:00+08:00"
    assert table.tell(complete=True).status_code == table.tell().status_code == 202  # `complete` is taken back
    with state.database.read() as session:
        assert "complete" not in session.query(Meal).one().after_details
    assert table.tell(**told, captured_at="2026-11-20T12:57:00+08:00").status_code == 202
    table.put("after_left")
    other = table.tell(**told, captured_at="2026-11-20T12:58:00+08:00")
    assert (*refusal(other), other.json()["fields"]) == (409, "after_pair_differs", ["captured_at"])


def test_pair_that_cannot_be_is_refused_and_nothing_is_kept(table):
    for body, code in (
        ({"captured_at": "2026-11-20T12:00:00+08:00"}, "after_pair_before_meal"),
        ({"captured_at": "2026-11-20T12:55:00"}, "time_without_offset"),
        ({"time_zone": "Mars/Base"}, "time_zone_unknown"),
        ({"hints": [{"point": [1, 2], "class": "gone"}]}, "metadata_invalid"),
        ({"hints": [{"item": str(uuid.uuid4())}]}, "metadata_invalid"),
    ):
        assert refusal(table.tell(**body)) == (422, code), body
    assert table.put("after_left", b"not a photograph").status_code == 415
    assert table.after is None


def test_pair_of_no_meal_of_another_s_of_a_declared_and_of_a_deleted_meal_is_refused(table, state, enrol):
    other, path = enrol("P002"), f"/v1/meals/{table.id}"
    for phone, meal in ((table.phone, f"/v1/meals/{uuid.uuid4()}"), (other, path)):
        assert phone.put(f"{meal}/images/after_left", content=photograph(1)).status_code == 404
    assert other.put(f"{path}/after", json={"captured_at": "2026-11-20T12:55:00+08:00"}).status_code == 404
    with state.database.write() as session:
        session.query(Meal).one().origin = "declared"
    assert refusal(table.put("after_left")) == (409, "meal_without_photographs")
    assert table.phone.client.delete(path, headers=table.phone.headers).status_code < 300
    assert refusal(table.put("after_left")) == (410, "meal_deleted")


def test_failed_pair_leaves_the_meal_alone_and_may_be_sent_anew_and_its_photographs_go(table, state):
    before = table.measured().get()
    failed = table.send_after().after_measured(failure=FAILURE).get()
    assert (failed["status"], failed["failure"], failed["after"]["status"]) == (before["status"], None, "failed")
    assert FAILURE.items() <= failed["after"]["failure"].items()
    assert all("after_failed" in item["flags"] and item["left_g"] is None for item in failed["items"])
    assert table.put("after_left").status_code == 200  # the same as failed: nothing new
    anew = table.put("after_left", seed=81).json()
    assert (anew["after"]["status"], anew["after"]["failure"]) == ("receiving", None)
    assert anew["after"]["missing"] == ["after_right"]
    assert all("after_failed" not in item["flags"] for item in anew["items"])
    assert table.put("after_right").status_code == 202  # the same bytes as before, under a key of their own
    with state.database.read() as session:
        wanted = {row.blob_key for row in session.query(BlobDeletion)}
        named = {image.blob_key for image in session.query(MealImage)}
    assert len(wanted) == 2
    assert not wanted & named
    table.after_measured(left_of_apple())
    assert table.after["status"] == "estimated"
    with state.database.read() as session:
        assert session.query(Run).filter(Run.purpose == "after").count() == 2


def test_pair_is_measured_also_where_the_meal_has_failed(table):
    table.measured(failure=FAILURE).send_after().after_measured(left_of_apple())
    meal = table.get()
    assert (meal["status"], meal["after"]["status"]) == ("failed", "needs_review")
    assert meal["after"]["leftovers"][0]["class"] == "unmatched"


def test_after_run_saved_twice_is_one_and_its_artefacts_are_served_apart(table, state):
    picture = b"\xff\xd8 a picture"
    key = f"x/{table.id}/overlay.jpg"
    state.blobs.put_bytes(key, picture)
    listed = {"name": "overlay.jpg", "media_type": "image/jpeg", "bytes": len(picture), "sha256": "0" * 64}
    table.ate(left_of_apple(), artefacts=[listed | {"blob_key": key}])
    (artefact,) = table.after["artefacts"]
    client, headers = table.phone.client, table.phone.headers
    assert client.get(artefact["href"], headers=headers).content == picture
    assert client.get(artefact["href"].removesuffix("?pair=after"), headers=headers).status_code == 404
    estimates.save(state, table.id, left_of_apple(), purpose="after")
    (leftover,) = table.after["leftovers"]
    schema = client.get("/openapi.json").json()["components"]["schemas"]
    assert set(table.after) == set(schema["AfterOut"]["properties"])
    assert set(leftover) == set(schema["LeftoverOut"]["properties"])
    assert json.dumps(schema["AfterMetadataIn"]).count('"class"')


def test_two_phones_that_send_the_same_photograph_at_once_keep_it_once(table, state):
    content = photograph(71)
    answers = at_once(*[lambda: table.put("after_left", content).status_code] * 4)
    assert sorted(answers) == [200, 200, 200, 202]
    with state.database.read() as session:
        assert session.query(MealImage).filter(MealImage.slot == "after_left").count() == 1
