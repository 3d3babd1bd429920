"""What a person may do with their data over the wire: delete a meal, leave, take all along; who reads the log."""

import base64
import csv
import io
import json
import threading
import uuid
import zipfile
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.core.errors import GoneError
from app.exports.export_places import ExportPlaces
from app.meals.stored.event_models import MealEvent
from app.meals.stored.identification_models import IndexEntry, ItemIdentification
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import EffectiveRecord, RunArtefact
from app.people import privacy_queries as privacy
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.last_use import LastUse
from app.people.devices import read_phone, sign_out_phone
from app.people.models import Device, Participant, PushSubscription, Study
from app.people.privacy_models import AuditEvent, BlobDeletion, Tombstone
from app.people.tombstones import public_digest
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.retention import erase_old_pictures
from app.vision.looks.vcm import VCM_VERSION
from tests.integration.conftest import meal_metadata
from tests.integration.people.persons import Person, database_bytes, kept_person
from tests.support.deadlocks import deadlock_over_a_meal
from tests.support.photo_files import coordinate_bytes, exif_block
from tests.support.photographs import pair, photograph
from tests.support.stores import store_bytes
from tests.support.waiting import PATIENCE_SECONDS, wait_for_blocked_transaction


def set_study(state, **values):
    with state.database.write() as session:
        session.execute(sa.update(Study).values(**values))


@pytest.fixture
def person(state, enrol, client, admin):
    return kept_person(state, enrol, client, admin, "somebody-9Qv", seed=1)


def test_deleted_meal_has_a_receipt_readable_by_id_alone_and_tombstones_and_each_call_of_it_is_410(
    person, client, state, enrol
):
    assert client.delete(person.path, headers=enrol("other").headers).status_code == 404
    assert person.phone.get(person.path).status_code == 200
    with state.database.read() as session:
        item_ids = list(session.scalars(sa.select(EffectiveRecord.item_id)))
        last = session.scalars(sa.select(Study.change_seq)).one()
    receipt = client.delete(person.path, headers=person.phone.headers).json()
    assert (receipt["what"], receipt["policy"]) == ("meal", "erase")
    assert receipt["counts"]["meal"] == 1
    assert receipt["counts"]["meal_image"] == 2
    assert client.get(f"/v1/receipts/{receipt['id']}").json() == receipt
    assert client.get(f"/v1/receipts/{uuid.uuid4()}").status_code == 404
    with state.database.read() as session:
        found = session.scalars(sa.select(Tombstone).where(Tombstone.kind == "record")).all()
    assert {row.digest for row in found} == {public_digest(item_id) for item_id in item_ids}
    assert all(row.change_seq > last for row in found)
    calls = [
        ("DELETE", "", "application/json"),
        ("GET", "", "application/json"),
        ("POST", "/events", "application/json"),
        ("PUT", "/images/left", "image/jpeg"),
        ("PUT", "/after", "application/json"),
        ("PUT", "", "application/json"),
    ]
    for method, below, content_type in calls:  # whatever the body
        headers = person.phone.headers | {"Content-Type": content_type}
        again = client.request(method, person.path + below, headers=headers, content=b"{}")
        told = (again.status_code, again.json()["code"], again.json()["receipt"])
        assert told == (410, "meal_deleted", receipt["id"]), (method, below)


def test_staff_delete_a_meal_and_hear_404_afterwards(person, client, admin):
    assert client.delete(person.path, headers=admin, params={"participant": person.mark}).status_code == 200
    assert client.get(person.path, headers=admin).status_code == 404


@pytest.mark.parametrize("policy", ["keep", "anonymise", "erase"])
def test_person_who_left_is_counted_their_calls_are_410_their_code_is_spent_and_their_data_stay_as_the_policy_says(
    policy, person, state, client, admin
):
    set_study(state, withdrawal_policy=policy)
    before = client.get("/v1/studies/pilot/overview", headers=admin).json()["participants"]
    receipt = client.post("/v1/me/withdrawal", headers=person.phone.headers).json()
    assert (receipt["what"], receipt["policy"]) == ("participant", policy)
    after = client.get("/v1/studies/pilot/overview", headers=admin).json()["participants"]
    assert (before["everybody"], before["withdrawn"]) == (1, 0)
    assert (after["everybody"], after["withdrawn"], after["erased"]) == (1, 1, policy == "erase")
    with state.database.read() as session:  # what their food looked like
        assert list(session.scalars(sa.select(ItemIdentification.vector))) == [person.vector] * (policy != "erase")
        assert list(session.scalars(sa.select(IndexEntry.food_key))) == ["apple"] * (policy != "erase")
        assert session.scalars(sa.select(PushSubscription)).all() == []
    if policy == "keep":
        with state.database.read() as session:
            assert session.scalars(sa.select(Participant)).one().withdrawn_at is not None
            assert session.scalars(sa.select(BlobDeletion)).all() == []
        assert client.get(person.path, headers=admin, params={"participant": person.mark}).status_code == 200
    for method, path in (
        ("GET", person.path),
        ("GET", "/v1/records"),
        ("GET", "/v1/me/export"),
        ("GET", "/v1/foods"),
        ("POST", "/v1/me/withdrawal"),
        ("DELETE", person.path),
    ):
        answer = client.request(method, path, headers=person.phone.headers)
        assert (answer.status_code, answer.json()["code"]) == (410, "withdrawn"), (method, path)
        assert set(answer.json()) == {"type", "title", "status", "detail", "code", "retryable", "receipt"}
        assert answer.json()["receipt"] == receipt["id"]
    assert person.phone.post(pair(7)).status_code == 410
    answer = client.post("/v1/enrolments", json={"code": f"code of {person.mark}", "device_name": "again"})
    assert answer.status_code == 404
    again = client.post("/v1/studies/pilot/participants", headers=admin, json={"code": person.mark})
    expected = "participant_exists" if policy == "keep" else "participant_code_spent"
    assert (again.status_code, again.json()["code"]) == (409, expected)
    client.post("/v1/studies", headers=admin, json={"code": "other", "name": "Other", "marker": "plain:9x7:11"})
    elsewhere = client.post("/v1/studies/other/participants", headers=admin, json={"code": person.mark})
    assert elsewhere.status_code == 201


@pytest.mark.both_stores
def test_concurrent_withdrawals_name_one_receipt(person, state, client):
    def leave(_):
        return client.post("/v1/me/withdrawal", headers=person.phone.headers)

    with ThreadPoolExecutor(3) as pool:
        answers = list(pool.map(leave, range(3)))
    assert {answer.status_code for answer in answers} <= {200, 410}
    assert len({answer.json().get("receipt") or answer.json()["id"] for answer in answers}) == 1


@pytest.mark.both_stores
def test_text_sent_while_its_person_is_anonymised_is_not_kept(person, state, client, monkeypatch):
    set_study(state, withdrawal_policy="anonymise")
    nearly_done = threading.Event()
    note = audit.note

    def note_slowly(session, caller, action, **details):
        note(session, caller, action, **details)
        if action == "participant.withdraw":
            nearly_done.set()
            wait_for_blocked_transaction(state.database)  # the text waits for this one

    monkeypatch.setattr(audit, "note", note_slowly)

    def say():
        nearly_done.wait(PATIENCE_SECONDS)
        told = {"id": str(uuid.uuid4()), "kind": "comment", "text": "it is me, Ottilie"}
        return client.post(f"{person.path}/events", headers=person.phone.headers | {"If-Match": "*"}, json=told)

    with ThreadPoolExecutor(1) as pool:
        saying = pool.submit(say)
        assert client.post("/v1/me/withdrawal", headers=person.phone.headers).status_code == 200
        answer = saying.result()
    assert (answer.status_code, answer.json()["code"]) == (410, "withdrawn")
    with state.database.read() as session:
        assert "Ottilie" not in str([event.new for event in session.scalars(sa.select(MealEvent))])


@pytest.mark.both_stores
def test_withdrawal_and_a_fresh_enrolment_code_at_once_do_not_block_each_other(
    person, state, client, admin, monkeypatch
):
    client.post(f"/v1/studies/pilot/participants/{person.mark}/enrolment-codes", headers=admin)
    issuing, end = threading.Event(), people.end_enrolments

    def end_slowly(session, participant_id, now):
        issuing.set()
        wait_for_blocked_transaction(state.database)  # the withdrawal waits for this one
        end(session, participant_id, now)

    monkeypatch.setattr(people, "end_enrolments", end_slowly)
    path = f"/v1/studies/pilot/participants/{person.mark}/enrolment-codes"
    with ThreadPoolExecutor(1) as pool:
        issued = pool.submit(client.post, path, headers=admin)
        issuing.wait(PATIENCE_SECONDS)
        left = client.post("/v1/me/withdrawal", headers=person.phone.headers)
        assert (issued.result().status_code, left.status_code) == (201, 200)
    answer = client.post("/v1/enrolments", json={"code": issued.result().json()["code"], "device_name": "again"})
    assert answer.status_code == 404


@pytest.mark.both_stores
def test_withdrawal_succeeds_despite_a_deadlock_with_a_holder_of_a_meal(person, state, client):
    with deadlock_over_a_meal(state.database, person.meal_id, privacy.join_participant):
        assert client.post("/v1/me/withdrawal", headers=person.phone.headers).status_code == 200


@pytest.mark.both_stores
def test_call_of_a_phone_whose_person_is_erased_meanwhile_is_410(person, state, client):
    with state.database.read() as session:
        study_id = session.scalars(sa.select(Study.id)).one()
    phone = DeviceCaller(person.device_id, person.participant_id, study_id, uuid.uuid4())
    client.post("/v1/me/withdrawal", headers=person.phone.headers)
    for call in (read_phone, sign_out_phone):
        with pytest.raises(GoneError) as caught:
            call(state.database, phone)
        assert caught.value.code == "withdrawn"


def test_anonymised_data_identify_nobody_and_keep_food_and_times(person, state, settings, client, admin):
    set_study(state, withdrawal_policy="anonymise")
    with state.database.read() as session:
        meal = session.scalars(sa.select(Meal)).one()
        day, captured_at = meal.local_date, meal.captured_at
        before = [(row.food_id, row.volume_ml, row.consumed_g) for row in records(session)]
        keys = [*session.scalars(sa.select(MealImage.blob_key)), *session.scalars(sa.select(RunArtefact.blob_key))]
    client.post("/v1/me/withdrawal", headers=person.phone.headers)
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    state.part(LastUse).settle()
    assert state.database.empty_log()
    with state.database.read() as session:
        meal = session.scalars(sa.select(Meal)).one()
        assert (meal.local_date, meal.captured_at) == (day, captured_at)
        assert [(row.food_id, row.volume_ml, row.consumed_g) for row in records(session)] == before
        assert session.scalars(sa.select(MealImage)).all() == []
        (comment,) = session.scalars(sa.select(MealEvent).where(MealEvent.kind == "comment"))
        assert comment.new == {"text": ""}
        device = session.scalars(sa.select(Device)).one()
        assert (device.model, device.app_version, device.last_used_at) == (None, None, None)
        someone = session.scalars(sa.select(Participant)).one()
        assert (someone.profile, someone.favourites, someone.code[:10]) == (None, None, "withdrawn-")
    assert not any(state.blobs.has(key) for key in keys)
    told = [
        person.mark,
        person.metadata["id"],
        uuid.UUID(person.metadata["id"]).hex,
        person.token_sha256,
        *map(str, person.aliases),
    ]
    held = database_bytes(state.database)
    with state.database.read() as session:  # the log keeps aliases, which lead to nobody now
        logged = b" ".join(str(row).encode() for row in session.execute(sa.select(AuditEvent.__table__)))
    for text in told:
        needle = text.lower().encode()
        at = held.find(needle)
        assert at < 0 or needle in logged, held[max(0, at - 200) : at + 100]
    pictures = store_bytes(state.blobs)
    assert not any(content[100:164].lower() in pictures for content in person.photos.values())
    assert client.get("/v1/records", headers=admin).json()["items"][0]["participant"] == someone.code


def records(session):
    return session.scalars(sa.select(EffectiveRecord).order_by(EffectiveRecord.item_id)).all()


def test_owner_withdraws_a_participant_once_and_again_only_if_the_policy_asks_for_more(person, state, client, admin):
    set_study(state, withdrawal_policy="keep")
    path = f"/v1/studies/pilot/participants/{person.mark}/withdrawal"
    assert client.post(path, headers=admin).json()["policy"] == "keep"
    again = client.post(path, headers=admin)
    assert (again.status_code, again.json()["code"]) == (409, "participant_withdrawn")
    set_study(state, withdrawal_policy="erase")
    assert client.post(path, headers=admin).json()["policy"] == "erase"
    assert client.post(path, headers=admin).status_code == 404
    assert client.post("/v1/studies/none/participants/x/withdrawal", headers=admin).status_code == 404


def test_photographs_past_retention_go_and_records_stay(person, state, client, admin):
    assert erase_old_pictures(state.database, datetime.now(UTC) + timedelta(days=10_000)) == 0  # no study has any
    set_study(state, retention_days=30)
    with state.database.read() as session:
        keys = list(session.scalars(sa.select(MealImage.blob_key)))
        received_at = session.scalars(sa.select(Meal.received_at)).one()
    assert erase_old_pictures(state.database, received_at + timedelta(days=29)) == 0
    before = client.get("/v1/records", headers=admin).json()
    assert erase_old_pictures(state.database, received_at + timedelta(days=31)) == 1
    assert erase_old_pictures(state.database, received_at + timedelta(days=31)) == 0
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert not any(state.blobs.has(key) for key in keys)
    assert client.get("/v1/records", headers=admin).json() == before
    with state.database.read() as session:
        assert all(image.erased_at for image in session.scalars(sa.select(MealImage)))
        assert session.scalars(sa.select(RunArtefact)).all() == []
        assert session.scalars(sa.select(ItemIdentification.vector)).all() == [person.vector]  # a measurement
        assert session.scalars(sa.select(IndexEntry)).one()
    for name in ("images/left", "artefacts/topview.jpg"):
        answer = person.phone.get(f"{person.path}/{name}")
        assert (answer.status_code, answer.json()["code"]) == (410, "photograph_erased"), name
    assert person.phone.post(person.photos, person.metadata).status_code == 200  # the phone may ask whether it is here


def test_export_contains_all_data_and_the_original_photographs_and_is_noted_as_a_read_of_them(person, state, enrol):
    Person(state, enrol, "another-one-3Fd", seed=5)
    answer = person.phone.get("/v1/me/export")
    assert answer.headers["content-disposition"] == 'attachment; filename="my-data.zip"'
    assert int(answer.headers["content-length"]) == len(answer.content)
    archive = zipfile.ZipFile(io.BytesIO(answer.content))
    data = json.loads(archive.read("data.json"))
    assert data["participant"]["code"] == person.mark
    assert {len(data[name]) for name in ("devices", "days", "day_events", "camera_calibrations")} == {1}
    (meal,) = data["meals"]
    assert meal["client_id"] == person.metadata["id"]
    assert meal["events"][0]["new"]["text"] == f"said {person.mark}"
    assert meal["candidates"][0]["food"]["name"]
    assert meal["records"]
    assert base64.b64decode(meal["looks"][0]["vector"]) == person.vector
    assert meal["looks"][0]["vcm_version"] == VCM_VERSION
    assert meal["known_to_the_index"][0]["food_key"] == "apple"
    assert any(candidate["source"] == "index" and candidate["run_id"] for candidate in meal["candidates"])
    for image in meal["photographs"]:
        assert archive.read(image["file"]) == person.photos[image["slot"]]
    assert "README.txt" in archive.namelist()
    everything = b" ".join(archive.read(name) for name in archive.namelist())
    assert b"another-one-3Fd" not in everything
    assert person.token_sha256.encode() not in everything
    assert list(state.blobs.staging_folder().iterdir()) == []
    with state.database.read() as session:
        event = session.scalars(sa.select(AuditEvent).where(AuditEvent.action == "photograph.read")).one()
        subject = str(session.get_one(Participant, person.participant_id).alias)
    assert (event.actor_kind, event.subject) == ("device", subject)
    assert event.details == {"by": "export", "photographs": 2}


def test_export_of_many_meals_holds_each_in_the_order_of_eating(person, state):
    with state.database.write() as session:
        meal = session.scalars(sa.select(Meal)).one()
        plain = {key: getattr(meal, key) for key in Meal.__table__.columns.keys()}  # noqa: SIM118
        for n in range(1, 46):
            other = {"id": uuid.uuid4(), "client_id": uuid.uuid4(), "alias": uuid.uuid4()}
            session.add(Meal(**plain | other | {"captured_at": meal.captured_at + timedelta(minutes=n)}))
    answer = person.phone.get("/v1/me/export")
    assert answer.status_code == 200
    told = json.loads(zipfile.ZipFile(io.BytesIO(answer.content)).read("data.json"))["meals"]
    assert len(told) == 46
    assert [each["captured_at"] for each in told] == sorted(each["captured_at"] for each in told)


def test_exports_at_once_are_bounded_for_a_person_and_for_all_and_each_leaves_its_place_when_it_ends_or_fails(
    person, state, enrol, monkeypatch
):
    places = state.part(ExportPlaces)
    own = [places.take(person.participant_id) for _ in range(2)]
    answer = person.phone.get("/v1/me/export")
    assert (answer.status_code, answer.json()["code"], answer.headers["Retry-After"]) == (503, "server_busy", "60")
    assert enrol("other").get("/v1/me/export").status_code == 200
    own[0]()
    for _ in range(3):
        assert person.phone.get("/v1/me/export").status_code == 200
    own[1]()
    others = [places.take(uuid.uuid4()) for _ in range(7)]
    with monkeypatch.context() as patched:
        patched.setattr("app.privacy.export_me.README", None)
        assert person.phone.get("/v1/me/export").status_code == 500
    assert person.phone.get("/v1/me/export").status_code == 200
    others.append(places.take(uuid.uuid4()))
    assert person.phone.get("/v1/me/export").status_code == 503
    for leave in others:
        leave()
    assert person.phone.get("/v1/me/export").status_code == 200


def test_audit_log_pages_filters_and_exports(person, client, admin, state):
    for _ in range(3):
        person.phone.get("/v1/me/export")
    url, events = "/v1/studies/pilot/audit?action=photograph.read&limit=2", []
    while url:
        page = client.get(url, headers=admin).json()
        events += page["items"]
        url = page["next"]
    assert [event["action"] for event in events] == ["photograph.read"] * 3
    assert [event["id"] for event in events] == sorted(event["id"] for event in events)
    assert {event["study"] for event in events} == {"pilot"}
    rows = list(csv.DictReader(io.StringIO(client.get("/v1/audit?format=csv", headers=admin).text)))
    assert [row["action"] for row in rows].count("photograph.read") == 3
    assert len(rows) == len(client.get("/v1/audit?limit=1000", headers=admin).json()["items"])
    later = (datetime.now(UTC) + timedelta(days=1)).isoformat()
    assert client.get("/v1/audit", headers=admin, params={"from": later}).json()["items"] == []
    assert client.get("/v1/audit", headers=admin, params={"to": later, "action": "no.such"}).json()["items"] == []
    crossed = client.get("/v1/audit", headers=admin, params={"from": later, "to": "2020-01-01T00:00:00Z"})
    assert (crossed.status_code, crossed.json()["code"]) == (422, "days_reversed")
    first = client.get("/v1/audit?limit=1", headers=admin).json()["next"]
    answer = client.get(first.replace("/v1/audit", "/v1/studies/pilot/audit"), headers=admin)
    assert (answer.status_code, answer.json()["code"]) == (422, "cursor_of_other_filters")
    assert client.get("/v1/audit", headers=person.phone.headers).status_code == 403


@pytest.mark.both_stores
def test_audit_log_cannot_be_changed_or_cut_by_the_database_itself(person, state):
    person.phone.get("/v1/me/export")
    statements = ["UPDATE audit_event SET actor = 'nobody'", "DELETE FROM audit_event"]
    if state.database.is_sqlite:
        columns = "id, at, actor_kind, actor, action, details"
        statements.append(f"REPLACE INTO audit_event ({columns}) SELECT {columns} FROM audit_event")
    else:
        statements.append("TRUNCATE audit_event")
    for statement in statements:
        with pytest.raises(sa.exc.DBAPIError), state.database.write() as session:
            session.execute(sa.text(statement))


EXACT = {"latitude": 34.1391839, "longitude": -118.1250041, "accuracy_m": 4.5}


def located_pair():
    """Photographs whose EXIF tells the place of tests/support/photo_files.py."""
    block = exif_block()
    return {"left": photograph(1, exif=b"Exif\0\0" + block), "right": photograph(2, exif=b"Exif\0\0" + block)}


@pytest.mark.parametrize("policy", ["drop", "round", "keep"])
def test_no_byte_of_the_exact_place_is_kept_unless_the_study_keeps_places(policy, phone, state):
    set_study(state, location_policy=policy, location_decimals=1 if policy == "round" else None)
    exact = [b"34.1391839", b"118.1250041", *(each.lower() for each in coordinate_bytes())]
    for told in (None, EXACT):
        meal_id = phone.post(located_pair(), location=told).json()["id"]
        with state.database.read() as session:
            query = sa.select(Meal).where(Meal.client_id == uuid.UUID(meal_id))
            kept = session.scalars(query).one().details["location"]
        rounded = {"latitude": 34.1, "longitude": -118.1} if told else {"latitude": 40.4, "longitude": -86.9}
        assert kept == {"drop": None, "round": rounded, "keep": told}[policy]
        held = database_bytes(state.database) + store_bytes(state.blobs)
        assert any(needle in held for needle in exact) == (policy == "keep")


def test_place_of_a_photograph_that_comes_by_itself_is_rounded_too(phone, state):
    set_study(state, location_policy="round", location_decimals=2)
    body = meal_metadata()
    meal_id = body.pop("id")
    phone.put(f"/v1/meals/{meal_id}", json=body)
    phone.put(
        f"/v1/meals/{meal_id}/images/left", content=located_pair()["left"], headers={"Content-Type": "image/jpeg"}
    )
    with state.database.read() as session:
        kept = session.scalars(sa.select(Meal)).one().details["location"]
    assert kept is not None
    assert all(value == round(value, 2) for value in kept.values())
    assert phone.put(f"/v1/meals/{meal_id}", json=body).status_code == 200  # the same metadata, as far as it was told


def test_logs_name_no_person_and_no_meal_of_theirs(enrol, client, admin, capsys):
    mark = "person-in-no-log-5Tz"
    phone, body = enrol(mark), meal_metadata(location=EXACT)
    phone.post(pair(3), body)
    phone.get(f"/v1/meals/{body['id']}")
    client.get(f"/v1/meals/{body['id']}", headers=admin, params={"participant": mark})
    client.get(f"/v1/no/such/path/{mark}", headers=admin)
    client.delete(f"/v1/meals/{body['id']}", headers=phone.headers)
    client.post(f"/v1/studies/pilot/participants/{mark}/withdrawal", headers=admin)
    told = capsys.readouterr()
    log = told.out + told.err
    assert "/v1/meals/{meal_id}" in log
    assert "meal_queued" in log
    token = phone.headers["Authorization"].removeprefix("Bearer ")
    for secret in (mark, body["id"], uuid.UUID(body["id"]).hex, token, "34.139"):
        assert secret not in log
