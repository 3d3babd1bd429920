"""Hostile input and races: none makes a server error, none loses a photograph that was acknowledged."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from concurrent.futures import ThreadPoolExecutor

import httpx2
import pytest

from app.meals.stored.models import MealImage
from app.meals.upload.submit_meal import SubmitMeal
from tests.integration.conftest import meal_metadata
from tests.integration.records.at_once import at_once
from tests.support.photographs import pair, photograph
from tests.support.stores import stored_names
from tests.support.waiting import PATIENCE_SECONDS, wait_until


def missing_blobs(state):
    """Keys that the database names and the store does not have."""
    with state.database.read() as session:
        return [image.blob_key for image in session.query(MealImage) if not state.blobs.has(image.blob_key)]


QUESTIONS = (
    "/v1/records?study=%00",
    "/v1/records?participant=%00",
    "/v1/records?food=%00",
    "/v1/records?food=%00&format=csv",
    "/v1/foods/a%00b",
    "/v1/meals/0b0ccda4-7f0e-4e34-9a39-1f0c6d3bb9c1?participant=%00",
)
CALLS = {
    "/v1/studies": {"code": "s", "name": "a\0b"},
    "/v1/studies/pi%00lot/participants": {"code": "P1"},
    "/v1/studies/pilot/participants/P%001/enrolment-codes": None,
}


def test_nul_is_no_server_error_in_metadata_a_question_an_admin_s_call_or_a_device_s_name(client, admin, phone, state):
    for change in ({"app_version": "1\0"}, {"hints": [{"food": "app\0le"}]}):
        answer = phone.post(pair(), **change)
        assert (answer.status_code, answer.json()["code"]) == (422, "metadata_invalid")
    assert stored_names(state.blobs) == []
    for path in QUESTIONS:
        assert client.get(path, headers=admin).status_code in {200, 404, 422}, path
    for path, body in CALLS.items():
        assert client.post(path, headers=admin, json=body).status_code in {404, 422}, path
    code = client.post("/v1/studies/pilot/participants/P001/enrolment-codes", headers=admin).json()["code"]
    refused = client.post("/v1/enrolments", json={"code": code, "device_name": "a\0b"})
    assert refused.status_code == 422
    assert client.post("/v1/enrolments", json={"code": code, "device_name": "ab"}).status_code == 201


@pytest.mark.both_stores
def test_same_study_or_participant_made_at_once_is_made_once_and_else_a_conflict(client, admin):
    for path, body in (
        ("/v1/studies", {"code": "race", "name": "race"}),
        ("/v1/studies/race/participants", {"code": "race"}),
    ):
        answers = at_once(*[lambda path=path, body=body: client.post(path, headers=admin, json=body)] * 8)
        assert sorted(answer.status_code for answer in answers) == [201] + [409] * 7, path


def test_full_disk_of_one_upload_takes_no_blob_of_the_same_meal_that_was_accepted(phone, state, monkeypatch):
    """The phone sends again while its first request is still under way; the first then finds the disk full."""
    metadata, photos, again = meal_metadata(), pair(), []
    put_files = type(state.blobs).put_files

    def full_at_right(self, files):
        if not again:
            again.append(None)
            put_files(self, {key: source for key, source in files.items() if "/left/" in key})
            again[0] = phone.post(photos, metadata)
            raise OSError(errno.ENOSPC, "No space left on device")
        put_files(self, files)

    monkeypatch.setattr(type(state.blobs), "put_files", full_at_right)
    assert phone.post(photos, metadata).status_code == 503
    assert again[0].status_code == 202
    assert missing_blobs(state) == []


def test_conflict_of_one_upload_takes_no_blob_that_another_has_just_sealed(phone, state, monkeypatch):
    """POST (left, other right) loses against PUT right and removes its left, which PUT left has sealed meanwhile."""
    metadata = meal_metadata()
    client_id = metadata["id"]
    left, right, other_right = (photograph(seed) for seed in (1, 2, 3))
    announcement = {key: value for key, value in metadata.items() if key != "id"}
    phone.put(f"/v1/meals/{client_id}", json=announcement)
    sealed, refused, answers = threading.Event(), threading.Event(), {}
    write = SubmitMeal._write

    def put(slot, content):
        answers[slot] = phone.put(f"/v1/meals/{client_id}/images/{slot}", content=content).status_code

    puts_left = threading.Thread(target=put, args=("left", left))

    def staged_write(self, caller, upload, photos, keys):
        if upload.draft is not None:
            put("right", right)
            puts_left.start()
            assert sealed.wait(PATIENCE_SECONDS)
        elif "left" in photos:
            sealed.set()
            assert refused.wait(PATIENCE_SECONDS)
        return write(self, caller, upload, photos, keys)

    monkeypatch.setattr(SubmitMeal, "_write", staged_write)
    assert phone.post({"left": left, "right": other_right}, metadata).status_code == 409
    refused.set()
    puts_left.join()
    assert answers == {"right": 202, "left": 202}
    assert missing_blobs(state) == []


def test_crash_answers_with_the_requests_id(client, phone, monkeypatch):
    def crash(*_, **__):
        raise RuntimeError

    monkeypatch.setattr("app.meals.stored.queries.find_meals", crash)
    answer = phone.get(f"/v1/meals/{uuid.uuid4()}")
    assert answer.status_code == 500
    assert len(answer.headers.get("x-request-id", "")) == 32


@pytest.mark.slow
def test_who_waits_at_shutdown_gets_the_meal_as_it_is(tmp_path):
    environment = os.environ | {"TADA_DATA_DIR": str(tmp_path), "TADA_PORT": "0", "TADA_MIN_FREE_BYTES": "0"}
    tada = [sys.executable, "-m", "app.cli"]
    made = subprocess.run([*tada, "admin", "create", "a"], env=environment, capture_output=True, text=True, check=True)
    admin = {"Authorization": f"Bearer {next(w for w in made.stdout.split() if w.startswith('tada_'))}"}
    with subprocess.Popen([*tada, "serve"], env=environment, stderr=subprocess.PIPE, text=True) as server:
        try:
            address = next(line.split()[-1] for line in server.stderr if "listens on" in line)
            threading.Thread(target=server.stderr.read, daemon=True).start()
            with httpx2.Client(base_url=address, timeout=60) as client:
                client.post("/v1/studies", headers=admin, json={"code": "s", "name": "s", "marker": "plain:9x7:11"})
                client.post("/v1/studies/s/participants", headers=admin, json={"code": "P"})
                code = client.post("/v1/studies/s/participants/P/enrolment-codes", headers=admin).json()["code"]
                token = client.post("/v1/enrolments", json={"code": code, "device_name": "p"}).json()["token"]
                phone = {"Authorization": f"Bearer {token}"}
                metadata = meal_metadata()
                path = f"/v1/meals/{metadata.pop('id')}"
                assert client.put(path, headers=phone, content=json.dumps(metadata)).status_code == 202
                with ThreadPoolExecutor(1) as pool:
                    waiting = pool.submit(client.get, path, headers=phone, params={"wait": "50"})
                    wait_until(lambda: "in_flight 2.0" in client.get("/metrics").text, "the call to wait")
                    started = time.monotonic()
                    server.send_signal(signal.SIGTERM)
                    answer = waiting.result(timeout=30)
                    assert (answer.status_code, time.monotonic() - started < 5) == (200, True), answer.text
        finally:
            if server.poll() is None:
                server.kill()
