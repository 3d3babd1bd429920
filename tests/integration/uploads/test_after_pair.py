"""An after-meal pair comes in: slots, words about it, idempotency, its own status."""

import json
import threading
import uuid

import pytest

from app.meals.job_models import Job
from app.meals.models import Meal, MealImage
from app.meals.record_models import Run
from app.people.privacy_models import BlobDeletion
from app.uploads.waiting import MealWaiter
from tests.support import estimates
from tests.integration.records.after_pairs import Table, left_of_apple
from tests.support.photographs import photograph
from tests.support.waiting import wait_until

FAILURE = {"code": "marker_not_found", "message": "No board.", "advice": "Put it beside the plate."}


@pytest.fixture
def table(phone, state):
    return Table(phone, state)


def jobs_for(state, purpose):
    with state.database.read() as session:
        return session.query(Job).filter(Job.purpose == purpose).all()


def test_meal_without_an_after_pair_has_none(table):
    assert table.after is None


def test_pair_is_queued_with_its_second_photograph_and_the_meal_stays_as_it_is(table, state):
    before = table.measured().get()
    first = table.put("after_left").json()
    assert (first["status"], first["after"]["status"], first["after"]["missing"]) == (
        before["status"],
        "receiving",
        ["after_right"],
    )
    assert jobs_for(state, "after") == []
    second = table.put("after_right").json()
    assert (second["status"], second["after"]["status"], second["after"]["missing"]) == (before["status"], "queued", [])
    assert before["version"] < first["version"] < second["version"]
    assert len(jobs_for(state, "after")) == 1
    assert set(second["after"]["images"]) == {"after_left", "after_right"}
    assert set(second["images"]) == {"left", "right"}


def test_pair_may_come_while_the_meal_is_still_queued(table, state):
    table.send_after()
    meal = table.get()
    assert (meal["status"], meal["after"]["status"]) == ("queued", "queued")
    assert len(jobs_for(state, "meal")) == len(jobs_for(state, "after")) == 1


def test_same_photograph_again_changes_nothing(table, state):
    table.send_after()
    tag = table.phone.get(f"/v1/meals/{table.id}").headers["etag"]
    again = table.put("after_left")
    assert (again.status_code, again.headers["etag"]) == (200, tag)
    assert len(jobs_for(state, "after")) == 1


def test_other_bytes_for_a_slot_are_refused_and_leave_no_blob(table, state):
    table.send_after()
    before = {blob.key for blob in state.blobs.keys("")}
    answer = table.put("after_left", seed=99)
    assert (answer.status_code, answer.json()["code"], answer.json()["slot"]) == (
        409,
        "after_pair_differs",
        "after_left",
    )
    assert {blob.key for blob in state.blobs.keys("")} == before


def test_what_is_told_of_the_pair_is_kept_and_the_same_again_is_the_same(table, state):
    item = str(uuid.uuid4())
    told = {"hints": [{"point": [5, 6], "item": item, "class": "refuse"}]}
    assert table.tell(**told).status_code == 202
    assert table.tell(**told).status_code == 200
    assert table.after["captured_at"] == "2026-11-20T12:55:00+08:00"
    with state.database.read() as session:
        meal = session.query(Meal).one()
        assert meal.after_details["hints"] == [{"point": [5.0, 6.0], "item": item, "class": "refuse"}]
        assert meal.after_details["time_zone"] == "Asia/Shanghai"


def test_another_word_of_the_pair_is_refused(table):
    table.tell()
    answer = table.tell(captured_at="2026-11-20T12:58:00+08:00")
    assert (answer.status_code, answer.json()["code"], answer.json()["fields"]) == (
        409,
        "after_pair_differs",
        ["captured_at"],
    )


def test_word_after_the_second_photograph_comes_too_late(table):
    table.send_after()
    answer = table.tell()
    assert (answer.status_code, answer.json()["code"]) == (409, "after_pair_queued")


def test_pair_before_its_meal_cannot_be(table):
    answer = table.tell(captured_at="2026-11-20T12:00:00+08:00")
    assert (answer.status_code, answer.json()["code"]) == (422, "after_pair_before_meal")


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({"captured_at": "2026-11-20T12:55:00"}, "time_without_offset"),
        ({"captured_at": "2026-11-20T12:55:00+09:00"}, "offset_not_in_zone"),
        ({"time_zone": "Mars/Base"}, "time_zone_unknown"),
        ({"hints": [{"point": [1, 2], "class": "gone"}]}, "metadata_invalid"),
        ({"hints": [{"item": str(uuid.uuid4())}]}, "metadata_invalid"),
    ],
)
def test_word_that_cannot_be_is_refused(table, body, code):
    answer = table.tell(**body)
    assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert table.after is None


def test_photograph_that_is_none_is_refused_and_nothing_kept(table):
    assert table.put("after_left", b"not a photograph").status_code == 415
    assert table.after is None


def test_pair_of_a_meal_that_is_not_there_is_not_found(phone):
    answer = phone.put(f"/v1/meals/{uuid.uuid4()}/images/after_left", content=photograph(1))
    assert answer.status_code == 404


def test_pair_of_anothers_meal_is_not_found(table, enrol):
    other = enrol("P002")
    answer = other.put(f"/v1/meals/{table.id}/images/after_left", content=photograph(1))
    assert answer.status_code == 404
    assert (
        other.put(f"/v1/meals/{table.id}/after", json={"captured_at": "2026-11-20T12:55:00+08:00"}).status_code == 404
    )


def test_pair_of_a_deleted_meal_is_gone(table):
    assert table.phone.client.delete(f"/v1/meals/{table.id}", headers=table.phone.headers).status_code < 300
    answer = table.put("after_left")
    assert (answer.status_code, answer.json()["code"]) == (410, "meal_deleted")


def test_pair_of_a_meal_without_photographs_is_refused(table, state):
    with state.database.write() as session:
        session.query(Meal).one().origin = "declared"
    answer = table.put("after_left")
    assert (answer.status_code, answer.json()["code"]) == (409, "meal_without_photographs")


def test_staff_do_not_send_pairs(table, client, admin):
    answer = client.put(f"/v1/meals/{table.id}/images/after_left", headers=admin, content=photograph(1))
    assert (answer.status_code, answer.json()["code"]) == (403, "device_only")


def test_failed_pair_is_an_answer_that_leaves_the_meal_alone(table):
    before = table.measured().get()
    table.send_after().after_measured(failure=FAILURE)
    meal = table.get()
    assert (meal["status"], meal["failure"]) == (before["status"], None)
    assert meal["after"]["status"] == "failed"
    assert FAILURE.items() <= meal["after"]["failure"].items()
    assert all("after_failed" in item["flags"] and item["left_g"] is None for item in meal["items"])


def test_failed_pair_may_be_sent_anew_and_its_photographs_go(table, state):
    table.measured().send_after().after_measured(failure=FAILURE)
    assert table.put("after_left").status_code == 200  # the same as failed: nothing new
    anew = table.put("after_left", seed=81).json()
    assert (anew["after"]["status"], anew["after"]["missing"], anew["after"]["failure"]) == (
        "receiving",
        ["after_right"],
        None,
    )
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


def test_wait_comes_back_when_the_pair_moves(table, state):
    tag = table.measured().send_after().phone.get(f"/v1/meals/{table.id}").headers["etag"]

    def measure():
        wait_until(lambda: state.part(MealWaiter)._waiting, "the call to wait")
        table.after_measured(left_of_apple())

    thread = threading.Thread(target=measure)
    thread.start()
    answer = table.phone.client.get(
        f"/v1/meals/{table.id}?wait=25", headers=table.phone.headers | {"If-None-Match": tag}
    )
    thread.join()
    assert answer.json()["after"]["status"] == "estimated"


def test_artefacts_of_the_after_run_are_served_apart(table, state):
    picture = b"\xff\xd8 a picture"
    key = f"x/{table.id}/overlay.jpg"
    state.blobs.put_bytes(key, picture)
    listed = {
        "name": "overlay.jpg",
        "media_type": "image/jpeg",
        "bytes": len(picture),
        "sha256": "0" * 64,
        "blob_key": key,
    }
    table.measured().send_after().after_measured(left_of_apple(), artefacts=[listed])
    (artefact,) = table.after["artefacts"]
    client, headers = table.phone.client, table.phone.headers
    assert client.get(artefact["href"], headers=headers).content == picture
    assert client.get(artefact["href"].removesuffix("?pair=after"), headers=headers).status_code == 404


def test_two_phones_that_send_the_same_photograph_at_once_keep_it_once(table, state):
    content, answers = photograph(71), []
    threads = [threading.Thread(target=lambda: answers.append(table.put("after_left", content))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answer.status_code for answer in answers) == [200, 200, 200, 202]
    with state.database.read() as session:
        assert session.query(MealImage).filter(MealImage.slot == "after_left").count() == 1


def test_saving_the_after_run_twice_makes_one(table, state):
    table.measured().send_after().after_measured(left_of_apple())
    estimates.save(state, table.id, left_of_apple(), purpose="after")
    assert len(table.after["leftovers"]) == 1


def test_answer_holds_what_the_schema_promises(table):
    table.measured().send_after().after_measured(left_of_apple())
    schema = table.phone.client.get("/openapi.json").json()["components"]["schemas"]
    assert set(table.after) == set(schema["AfterOut"]["properties"])
    assert set(table.after["leftovers"][0]) == set(schema["LeftoverOut"]["properties"])
    assert json.dumps(schema["AfterMetadataIn"]).count('"class"')
