"""A voice note of a meal: checked on arrival, kept, given out, listed, exported and erased as a photograph is."""

import hashlib
import io
import zipfile

import pytest
import sqlalchemy as sa

from app.meals.stored.models import MealImage
from app.meals.upload import api
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.support.photographs import pair
from tests.support.voice_notes import box, mp4, webm

NOTE = webm(2, sound=b"what I ate")


@pytest.fixture
def meal(phone):
    """The address of a meal that has its photographs."""
    return f"/v1/meals/{phone.post(pair()).json()['id']}"


def put(phone, meal, content=NOTE):
    return phone.put(f"{meal}/images/voice_note", content=content)


def test_note_is_kept_given_out_and_known_again(phone, meal):
    before = phone.get(meal).json()
    assert before["voice_note"] is None
    sent = put(phone, meal)
    note = sent.json()["voice_note"]
    assert sent.status_code == 202
    assert (note["media_type"], note["bytes"], note["durable"]) == ("audio/webm", len(NOTE), True)
    assert sent.json()["version"] == before["version"] + 1
    assert list(sent.json()["images"]) == ["left", "right"]
    assert put(phone, meal).status_code == 200
    assert refusal(put(phone, meal, mp4(b"soun"))) == (409, "meal_id_reused")
    answer = phone.get(f"{meal}/images/voice_note")
    assert (answer.content, answer.headers["content-type"]) == (NOTE, "audio/webm")
    assert answer.headers["content-disposition"] == "attachment"


@pytest.mark.parametrize(("policy", "stays"), [("round", False), ("keep", True)])
def test_coordinates_in_a_note_are_kept_only_by_a_study_that_keeps_places(enrol, state, policy, stays):
    place = b"+47.6062-122.3321/"
    content = mp4(b"soun") + box(b"meta", place)
    phone = enrol(location_policy=policy, location_decimals=1 if policy == "round" else None)
    sent = put(phone, f"/v1/meals/{phone.post(pair()).json()['id']}", content)
    assert sent.json()["voice_note"]["received_sha256"] == hashlib.sha256(content).hexdigest()
    with state.database.read() as session:
        note = session.scalars(sa.select(MealImage).where(MealImage.slot == "voice_note")).one()
    stored = state.blobs.read(note.blob_key)
    assert (place in stored, len(stored)) == (stays, len(content))
    assert note.stored_sha256 == hashlib.sha256(stored).hexdigest()


def test_note_neither_completes_a_meal_nor_holds_it_back(phone):
    metadata, photographs = meal_metadata(), pair()
    meal = f"/v1/meals/{metadata.pop('id')}"
    phone.put(meal, json=metadata)
    assert put(phone, meal).json()["missing"] == ["left", "right"]
    statuses = [phone.put(f"{meal}/images/{slot}", content=photographs[slot]).json()["status"] for slot in photographs]
    assert statuses == ["receiving", "queued"]


def test_picture_or_other_file_is_refused(phone, meal):
    for content in (mp4(b"vide"), pair()["left"]):
        assert refusal(put(phone, meal, content)) == (422, "voice_note_unreadable")
    assert phone.get(meal).json()["voice_note"] is None


def test_note_is_given_out_in_parts_as_players_ask_for_it(phone, meal):
    put(phone, meal)
    address = f"{meal}/images/voice_note"
    first = phone.client.get(address, headers=phone.headers | {"Range": "bytes=0-1"})
    assert (first.status_code, first.content) == (206, NOTE[:2])
    assert first.headers["content-range"] == f"bytes 0-1/{len(NOTE)}"
    assert phone.get(address).headers["accept-ranges"] == "bytes"
    beyond = phone.client.get(address, headers=phone.headers | {"Range": f"bytes={len(NOTE)}-"})
    assert beyond.status_code == 416


def test_long_note_is_refused_before_it_was_received(phone, meal, monkeypatch):
    monkeypatch.setattr(api, "MAX_NOTE_BYTES", len(NOTE) - 1)
    refused = put(phone, meal)
    assert (*refusal(refused), refused.json()["limit_bytes"]) == (413, "image_too_large", len(NOTE) - 1)
    monkeypatch.setattr(api, "MAX_NOTE_BYTES", 1000)
    monkeypatch.setattr(api, "submit_photograph", None)
    assert put(phone, meal, b"x" * 1001).json()["code"] == "image_too_large"
    path, headers = f"{meal}/images/voice_note/upload", phone.headers | {"Upload-Length": "1001"}
    refused = phone.client.post(path, headers=headers)
    assert (*refusal(refused), refused.json()["limit_bytes"]) == (413, "image_too_large", 1000)
    assert phone.client.post(path, headers=headers | {"Upload-Length": "1000"}).status_code == 201
    left = path.replace("voice_note", "left")
    assert phone.client.post(left, headers=headers).status_code == 201


def test_note_is_in_the_manifest_and_in_the_persons_own_data(phone, meal, client, admin):
    put(phone, meal)
    rows = client.get("/v1/studies/pilot/photographs", headers=admin).json()["items"]
    (row,) = [row for row in rows if row["slot"] == "voice_note"]
    assert (row["media_type"], row["width_px"], row["bytes"]) == ("audio/webm", 0, len(NOTE))
    assert client.get(row["path"], headers=admin).content == NOTE
    with zipfile.ZipFile(io.BytesIO(phone.get("/v1/me/export").content)) as archive:
        (name,) = [name for name in archive.namelist() if "voice_note" in name]
        assert name.endswith(".webm")
        assert archive.read(name) == NOTE


def test_note_is_erased_with_its_meal(phone, meal, state, client):
    put(phone, meal)
    with state.database.read() as session:
        key = session.scalar(sa.select(MealImage.blob_key).where(MealImage.slot == "voice_note"))
    assert state.blobs.read(key) == NOTE
    assert client.delete(meal, headers=phone.headers).status_code == 200
    with state.database.read() as session:
        assert session.scalars(sa.select(MealImage.blob_key)).all() == []
