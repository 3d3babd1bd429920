import hashlib
import threading
import uuid

import pytest
import sqlalchemy as sa

from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.upload.read_api import MealWaiter
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.support.photographs import pair, photograph
from tests.support.stores import stored_names
from tests.support.waiting import wait_until


def test_meal_in_one_request_is_durable_and_queued(phone, state):
    photos = pair()
    answer = phone.post(photos)
    body = answer.json()
    assert answer.status_code == 202
    assert answer.headers["location"] == f"/v1/meals/{body['id']}"
    assert (body["status"], body["missing"], body["failure"]) == ("queued", [], None)
    for slot, content in photos.items():
        image = body["images"][slot]
        assert image["received_sha256"] == hashlib.sha256(content).hexdigest()
        assert (image["durable"], image["bytes"], image["width_px"], image["height_px"]) == (
            True,
            len(content),
            640,
            480,
        )
    assert len(stored_names(state.blobs)) == 2
    with state.database.read() as session:
        assert session.query(Job).one().state == "queued"


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"captured_at": "2026-11-20T23:30:00.123456-05:00", "time_zone": "America/New_York", "app_version": "1.2"},
        {"hints": [{"box": [10, 10, 50, 50]}], "marker": "plain:9x7:11"},
        {"location": {"latitude": 31.23, "longitude": 121.47}},
    ],
)
def test_answer_to_a_new_meal_is_what_asking_for_it_gives(phone, changes):
    """The answer is made of what was written, without reading it again."""
    sent = phone.post(pair(), **changes)
    asked = phone.get(f"/v1/meals/{sent.json()['id']}")
    assert sent.status_code == 202, sent.text
    assert (sent.json(), sent.headers["etag"]) == (asked.json(), asked.headers["etag"])
    metadata = meal_metadata(**changes)
    announced = phone.put(f"/v1/meals/{metadata.pop('id')}", json=metadata)
    assert announced.json() == phone.get(f"/v1/meals/{announced.json()['id']}").json()


def test_asking_for_a_waiting_meal_takes_four_queries(phone, state):
    meal_id = phone.post(pair()).json()["id"]
    queries = []

    def note(_connection, _cursor, statement, *_):
        queries.append(statement)

    sa.event.listen(state.database.read_engine, "before_cursor_execute", note)
    try:
        assert phone.get(f"/v1/meals/{meal_id}").json()["status"] == "queued"
    finally:
        sa.event.remove(state.database.read_engine, "before_cursor_execute", note)
    assert len([each for each in queries if each.startswith("SELECT")]) == 4  # token, meal, whether it has more, images


def test_meal_part_by_part_is_queued_by_its_last_photograph(phone):
    metadata, photos = meal_metadata(), pair()
    path = f"/v1/meals/{metadata.pop('id')}"
    assert refusal(phone.put(f"{path}/images/right", content=photos["right"])) == (404, "not_found")
    announced = phone.put(path, json=metadata)
    assert (announced.status_code, announced.json()["status"]) == (202, "receiving")
    assert announced.json()["missing"] == ["left", "right"]
    headers = {"Content-Type": "image/jpeg"}
    right = phone.put(f"{path}/images/right", content=photos["right"], headers=headers)
    assert (right.json()["status"], right.json()["missing"]) == ("receiving", ["left"])
    assert phone.put(f"{path}/images/right", content=photos["right"], headers=headers).status_code == 200
    left = phone.put(f"{path}/images/left", content=photos["left"], headers=headers)
    assert (left.status_code, left.json()["status"]) == (202, "queued")


def test_same_meal_again_is_the_same_and_its_id_with_other_bytes_or_metadata_is_refused(phone, state):
    metadata, photos = meal_metadata(), pair()
    first, second = phone.post(photos, metadata), phone.post(photos, metadata)
    assert (first.status_code, second.status_code) == (202, 200)
    assert first.json() == second.json()
    before = stored_names(state.blobs)
    answer = phone.post(photos | {"right": photograph(99)}, metadata)
    assert (*refusal(answer), answer.json()["slot"]) == (409, "meal_id_reused", "right")
    answer = phone.post(photos, metadata | {"captured_at": "2026-11-20T13:30:00+08:00"})
    assert (*refusal(answer), answer.json()["fields"]) == (409, "meal_id_reused", ["captured_at"])
    assert stored_names(state.blobs) == before
    with state.database.read() as session:
        assert session.query(Job).count() == 1


def test_another_participants_id_is_free_and_does_not_get_in_the_way_of_staff(enrol, client, admin):
    one, other, metadata = enrol("P001"), enrol("P002"), meal_metadata()
    assert one.post(pair(1), metadata).status_code == 202
    url = f"/v1/meals/{metadata['id']}"
    assert other.get(url).status_code == 404
    assert client.get(url, headers=admin).json()["participant"] == "P001"
    assert other.post(pair(2), metadata).status_code == 202
    assert client.get(url, headers=admin).json()["participant"] == "P001"
    event = {"id": str(uuid.uuid4()), "kind": "comment", "text": "Which one?"}
    said = client.post(f"{url}/events", headers=admin | {"If-Match": "*"}, json=event)
    assert (said.status_code, said.json()["participant"]) == (201, "P001")
    assert client.get(url, headers=admin, params={"participant": "P002"}).json()["participant"] == "P002"


def test_deleted_meal_is_410_to_every_call_of_its_phone(phone):
    metadata, photos = meal_metadata(), pair()
    phone.post(photos, metadata)
    path = f"/v1/meals/{metadata['id']}"
    assert phone.client.delete(path, headers=phone.headers).status_code == 200
    for answer in (
        phone.post(photos, metadata),
        phone.get(path),
        phone.put(path, json={k: v for k, v in metadata.items() if k != "id"}),
        phone.put(f"{path}/images/left", content=photos["left"]),
        phone.client.delete(path, headers=phone.headers),
    ):
        assert (answer.status_code, answer.json()["code"]) == (410, "meal_deleted")


def test_wait_ends_when_the_meal_changes(phone, state):
    meal, answers = phone.post(pair()).json(), []
    path = f"/v1/meals/{meal['id']}"
    waiting = threading.Thread(target=lambda: answers.append(phone.get(path, wait=30).json()))
    waiting.start()
    wait_until(lambda: state.part(MealWaiter)._waiting, "the call to wait")
    with state.database.write() as session:
        row = session.query(Meal).one()
        row.status, row.stage, row.version = "processing", "marker", row.version + 1
    waiting.join()
    assert (answers[0]["status"], answers[0]["stage"]) == ("processing", "marker")


@pytest.mark.both_stores
def test_waiting_on_an_older_etag_answers_at_once_and_on_the_same_gives_304(phone):
    meal = phone.post(pair())
    url = f"/v1/meals/{meal.json()['id']}"
    for tag, wait, status in (('"0"', 60, 200), (meal.headers["etag"], 0.3, 304)):
        answer = phone.client.get(url, headers=phone.headers | {"If-None-Match": tag}, params={"wait": wait})
        assert answer.status_code == status
