"""Photographs in pieces by tus 1.0: what arrived is kept, nothing is doubled, what cannot be accepted is said."""

import base64
import hashlib
import os
import time
import uuid

import anyio
import pytest
import sqlalchemy as sa

from app.children.api_children import ApiChildren
from app.core.errors import UnavailableError
from app.http.rate_limit import UPLOAD_PATHS
from app.meals.upload import partial_uploads
from app.meals.upload.partial_uploads import KEPT_SECONDS, MOST_PER_PARTICIPANT, PartialUploads, UploadKey
from app.people.privacy_models import AuditEvent
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.support.photographs import pair, photograph

TUS = {"Tus-Resumable": "1.0.0"}
PIECE = TUS | {"Content-Type": "application/offset+octet-stream"}


class Upload:
    """One photograph's upload, as a tus client makes it."""

    def __init__(self, phone, meal, slot="left"):
        self.phone, self.path = phone, f"/v1/meals/{meal}/images/{slot}/upload"

    def _call(self, method, headers, **arguments):
        return self.phone.client.request(method, self.path, headers=self.phone.headers | headers, **arguments)

    def create(self, length, **headers):
        return self._call("POST", TUS | {"Upload-Length": str(length)} | headers)

    def head(self):
        return self._call("HEAD", TUS)

    def patch(self, offset, content, **headers):
        return self._call("PATCH", PIECE | {"Upload-Offset": str(offset)} | headers, content=content)

    def delete(self):
        return self._call("DELETE", TUS)


@pytest.fixture
def meal(phone):
    """An announced meal's id."""
    body = meal_metadata()
    meal = body.pop("id")
    assert phone.put(f"/v1/meals/{meal}", json=body).status_code == 202
    return meal


def images_of(phone, meal):
    return phone.get(f"/v1/meals/{meal}").json()["images"]


def test_photograph_in_three_pieces_is_the_photograph_and_noted_as_a_whole_one_is(phone, meal, state):
    def actions():
        with state.database.read() as session:
            return list(session.scalars(sa.select(AuditEvent.action).order_by(AuditEvent.id)))

    whole, content = pair().values()
    before = len(actions())
    phone.put(f"/v1/meals/{meal}/images/left", content=whole, headers={"Content-Type": "image/jpeg"})
    of_whole = actions()[before:]
    upload = Upload(phone, meal, "right")
    created = upload.create(len(content))
    assert (created.status_code, created.headers["location"]) == (201, upload.path)
    for start, end in ((0, 1000), (1000, 1001), (1001, len(content))):
        answer = upload.patch(start, content[start:end])
        assert (answer.status_code, answer.headers["upload-offset"]) == (204, str(end))
    image = images_of(phone, meal)["right"]
    assert image["durable"]
    assert image["received_sha256"] == hashlib.sha256(content).hexdigest()
    complete = upload.head()  # as a phone asks that lost the last answer
    assert (complete.status_code, complete.headers["upload-offset"]) == (204, str(len(content)))
    assert complete.headers["upload-length"] == str(len(content))
    assert phone.get(f"/v1/meals/{meal}").json()["status"] == "queued"
    assert actions()[before + len(of_whole) :] == of_whole != []


@pytest.fixture
def uploads(tmp_path):
    return PartialUploads(tmp_path)


@pytest.fixture
def key():
    return UploadKey(uuid.uuid4(), uuid.uuid4(), "left")


def test_what_came_before_the_connection_broke_is_kept(uploads, key):
    uploads.create(key, 300_000)

    async def broken():
        yield b"a" * 200_000
        yield b"b" * 1000
        raise ConnectionError

    async def receive():
        with uploads.opened(key, 0) as upload:
            await upload.append(broken(), anyio.CapacityLimiter(1))

    with pytest.raises(ConnectionError):
        anyio.run(receive)
    assert uploads.state(key).offset == 201_000


def test_piece_at_another_place_or_too_long_is_refused_and_an_upload_begun_anew_starts_at_nothing(phone, meal, enrol):
    upload, other = Upload(phone, meal), Upload(enrol("P002"), meal)
    for length in ("0", "x"):
        assert refusal(upload.create(length)) == (422, "invalid_input")
    assert refusal(upload.create("1000000000")) == (413, "image_too_large")
    upload.create(9000)
    upload.patch(0, b"a" * 100)
    answer = upload.patch(50, b"b" * 10)
    assert (*refusal(answer), answer.json()["offset"]) == (409, "upload_offset_differs", 100)
    assert upload.head().headers["upload-offset"] == "100"
    assert other.head().status_code == other.patch(0, b"a").status_code == 404
    assert Upload(phone, uuid.uuid4()).create(100).status_code == 404
    upload.create(200)
    head = upload.head().headers
    assert (head["upload-offset"], head["upload-length"]) == ("0", "200")
    assert refusal(upload.patch(0, b"a" * 201)) == (400, "upload_too_long")


def test_bytes_that_are_no_photograph_end_the_upload(phone, meal):
    upload = Upload(phone, meal)
    upload.create(1000)
    answer = upload.patch(0, b"a" * 1000)
    assert answer.status_code in (415, 422)
    assert upload.head().status_code == 404
    assert images_of(phone, meal) == {}


def test_last_byte_is_asked_for_again_until_the_photograph_is_kept(phone, meal, state, monkeypatch):
    content = photograph()
    upload = Upload(phone, meal)
    upload.create(len(content))

    def full(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    def no_child(*_arguments, **_options):
        raise UnavailableError("no child", code="server_busy", retry_after_seconds=3)

    for at, owner, name, failing in ((0, state.blobs, "put_files", full), (-1, ApiChildren, "_admitted", no_child)):
        monkeypatch.setattr(owner, name, failing)
        assert upload.patch(at % len(content), content[at:]).status_code == 503
        assert upload.head().headers["upload-offset"] == str(len(content) - 1)
        monkeypatch.undo()
    assert upload.patch(len(content) - 1, content[-1:]).status_code == 204
    assert images_of(phone, meal)["left"]["received_sha256"] == hashlib.sha256(content).hexdigest()


def repr_digest(content):
    return {"Repr-Digest": f"sha-256=:{base64.b64encode(hashlib.sha256(content).digest()).decode()}:"}


def test_two_halves_of_different_photographs_are_refused_by_the_digest_and_other_digests_ignored(phone, meal):
    first, second = pair().values()
    upload, half = Upload(phone, meal), len(second) // 2
    upload.create(len(second))
    upload.patch(0, first[:half])
    assert refusal(upload.patch(half, second[half:], **repr_digest(second))) == (409, "upload_digest_differs")
    assert upload.head().status_code == 404
    assert images_of(phone, meal) == {}
    upload.create(len(second))
    assert upload.patch(0, second[:50], **{"Repr-Digest": "sha-256=x"}).status_code == 204
    assert upload.patch(50, second[50:100], **{"Repr-Digest": ""}).status_code == 204
    assert upload.patch(100, second[100:], **repr_digest(second)).status_code == 204
    assert images_of(phone, meal)["left"]["durable"]
    right = Upload(phone, meal, "right")
    right.create(len(first))
    assert right.patch(0, first, **{"Repr-Digest": "sha-512=:" + "A" * 43 + "=:"}).status_code == 204


def test_upload_is_continued_after_a_restart(phone, meal, state):
    content = photograph()
    upload = Upload(phone, meal)
    upload.create(len(content))
    upload.patch(0, content[:5000])
    folder = state.blobs.partial_folder()
    state.blobs.remove_abandoned()
    (participant,) = folder.iterdir()
    again = PartialUploads(folder)
    key = UploadKey(uuid.UUID(participant.name), uuid.UUID(meal), "left")
    assert (again.state(key).offset, again.state(key).length) == (5000, len(content))


def test_calls_that_tus_does_not_know_are_refused(phone, meal):
    upload = Upload(phone, meal)
    assert upload.patch(0, b"a").json()["code"] == "upload_unknown"
    upload.create(10)
    assert upload.patch(0, b"a", **{"Tus-Resumable": "0.2.2"}).json()["code"] == "tus_version_unknown"
    assert upload.patch(0, b"a", **{"Content-Type": "image/jpeg"}).status_code == 415
    assert upload.delete().status_code == 204
    assert upload.head().status_code == 404


def test_upload_whose_beginning_a_crash_prevented_is_none_and_a_second_request_at_once_waits(uploads, key, tmp_path):
    uploads.create(key, 10)
    (tmp_path / key.participant.hex / f"{key.meal.hex}.left").write_bytes(b"")
    with pytest.raises(partial_uploads.NotFoundError):
        uploads.state(key)
    assert uploads.create(key, 10).offset == 0
    with uploads.opened(key, 0), pytest.raises(partial_uploads.UnavailableError) as busy, uploads.opened(key, 0):
        pass
    assert busy.value.code == "upload_busy"


def test_copy_that_fails_leaves_no_file(uploads, key, tmp_path, monkeypatch):
    staging = tmp_path / "staging"
    staging.mkdir()
    uploads.create(key, 10)

    def full(*_arguments):
        raise OSError(28, "No space left on device")

    with uploads.opened(key, 0) as upload:
        monkeypatch.setattr(partial_uploads.os, "fdopen", full)
        with pytest.raises(OSError, match="No space"):
            upload.photograph(staging)
    assert list(staging.iterdir()) == []


def test_unfinished_uploads_are_bounded_and_end_after_a_day(uploads, tmp_path):
    assert UPLOAD_PATHS.match(f"/v1/meals/{uuid.uuid4()}/images/left/upload")  # pieces count as uploads
    participant = uuid.uuid4()
    keys = [UploadKey(participant, uuid.uuid4(), "left") for _ in range(MOST_PER_PARTICIPANT)]
    for key in keys:
        uploads.create(key, 10)
    another = UploadKey(participant, uuid.uuid4(), "left")
    with pytest.raises(partial_uploads.ConflictError):
        uploads.create(another, 10)
    old = time.time() - KEPT_SECONDS - 1
    os.utime(tmp_path / participant.hex / f"{keys[0].meal.hex}.left", (old, old))
    assert uploads.create(another, 10).offset == 0
    with pytest.raises(partial_uploads.NotFoundError):
        uploads.state(keys[0])
