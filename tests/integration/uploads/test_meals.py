import hashlib
import uuid

import pytest
import sqlalchemy as sa

from app.meals.job_models import Job
from app.meals.models import Meal
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair, photograph
from tests.support.stores import stored_names


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


def test_same_meal_again_gives_200_and_the_same_answer(phone, state):
    photos, metadata = pair(), meal_metadata()
    first, second = phone.post(photos, metadata), phone.post(photos, metadata)
    assert (first.status_code, second.status_code) == (202, 200)
    assert first.json() == second.json()
    with state.database.read() as session:
        assert session.query(Job).count() == 1


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
    client_id = metadata.pop("id")
    announced = phone.put(f"/v1/meals/{client_id}", json=metadata)
    assert (announced.status_code, announced.json()["status"]) == (202, "receiving")
    assert announced.json()["missing"] == ["left", "right"]
    headers = {"Content-Type": "image/jpeg"}
    right = phone.put(f"/v1/meals/{client_id}/images/right", content=photos["right"], headers=headers)
    assert (right.json()["status"], right.json()["missing"]) == ("receiving", ["left"])
    again = phone.put(f"/v1/meals/{client_id}/images/right", content=photos["right"], headers=headers)
    assert again.status_code == 200
    left = phone.put(f"/v1/meals/{client_id}/images/left", content=photos["left"], headers=headers)
    assert (left.status_code, left.json()["status"]) == (202, "queued")


def test_photograph_of_an_unannounced_meal_is_404(phone):
    answer = phone.put(f"/v1/meals/{uuid.uuid4()}/images/left", content=photograph())
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


def test_id_reused_with_other_bytes_is_409_and_keeps_the_first(phone, state):
    metadata, photos = meal_metadata(), pair()
    phone.post(photos, metadata)
    before = stored_names(state.blobs)
    answer = phone.post(photos | {"right": photograph(99)}, metadata)
    assert (answer.status_code, answer.json()["code"], answer.json()["slot"]) == (409, "meal_id_reused", "right")
    assert stored_names(state.blobs) == before


def test_id_reused_with_other_metadata_is_409_and_names_the_field(phone):
    metadata, photos = meal_metadata(), pair()
    phone.post(photos, metadata)
    answer = phone.post(photos, metadata | {"captured_at": "2026-11-20T13:30:00+08:00"})
    assert (answer.status_code, answer.json()["fields"]) == (409, ["captured_at"])


def test_another_participants_id_is_simply_free(enrol):
    one, other = enrol("P001"), enrol("P002")
    metadata = meal_metadata()
    assert one.post(pair(1), metadata).status_code == 202
    assert other.post(pair(2), metadata).status_code == 202


def test_participant_cannot_read_another_participants_meal(enrol):
    one, other = enrol("P001"), enrol("P002")
    meal = one.post(pair()).json()
    assert other.get(f"/v1/meals/{meal['id']}").status_code == 404
    assert one.get(f"/v1/meals/{meal['id']}").status_code == 200


def test_participant_who_sends_anothers_meal_id_does_not_get_in_the_way_of_staff(enrol, client, admin):
    one, other, metadata = enrol("P001"), enrol("P002"), meal_metadata()
    one.post(pair(1), metadata)
    url = f"/v1/meals/{metadata['id']}"
    assert client.get(url, headers=admin).json()["participant"] == "P001"
    other.post(pair(2), metadata)
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


@pytest.mark.parametrize("headers", [{}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic eDp5"}])
def test_call_without_a_good_token_is_401(client, headers):
    for method, path in (
        ("GET", f"/v1/meals/{uuid.uuid4()}"),
        ("POST", "/v1/meals"),
        ("GET", "/v1/records"),
        ("GET", "/v1/foods"),
    ):
        answer = client.request(method, path, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthenticated")
        assert answer.headers["www-authenticate"] == "Bearer"


def test_admin_cannot_send_a_meal(client, admin):
    answer = client.post("/v1/meals", headers=admin, files={"left": b"x"})
    assert (answer.status_code, answer.json()["code"]) == (403, "device_only")


def test_device_cannot_make_a_study(client, phone):
    answer = client.post("/v1/studies", headers=phone.headers, json={"code": "x", "name": "x"})
    assert (answer.status_code, answer.json()["code"]) == (403, "admin_only")


def test_waiting_returns_when_the_meal_changes(phone, state):
    import threading

    meal = phone.post(pair()).json()

    def change():
        with state.database.write() as session:
            row = session.query(Meal).one()
            row.status, row.stage, row.version = "processing", "marker", row.version + 1

    timer = threading.Timer(0.5, change)
    timer.start()
    answer = phone.get(f"/v1/meals/{meal['id']}", wait=30)
    timer.join()
    assert (answer.json()["status"], answer.json()["stage"]) == ("processing", "marker")


def test_waiting_on_an_older_etag_answers_at_once_and_on_the_same_gives_304(phone):
    meal = phone.post(pair())
    url, headers = f"/v1/meals/{meal.json()['id']}", phone.headers
    old = phone.client.get(url, headers=headers | {"If-None-Match": '"0"'}, params={"wait": 60})
    assert old.status_code == 200
    same = phone.client.get(url, headers=headers | {"If-None-Match": meal.headers["etag"]}, params={"wait": 0.3})
    assert same.status_code == 304


def test_meal_without_any_marker_is_refused(enrol):
    phone = enrol("P009", study="nomarker", marker=None)
    answer = phone.post(pair())
    assert (answer.status_code, answer.json()["code"]) == (422, "marker_missing")
    assert phone.post(pair(), marker="plain:9x7:11").status_code == 202
