"""Exports in the background: requested over HTTP, made by a runner, downloaded in parts, expired and erased."""

import csv
import hashlib
import io
import json
import uuid
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.exports.background_exports import MOST_OF_PERSON
from app.exports.file_task import FileTasks
from app.exports.models import Export
from app.exports.releases import file_runner
from app.exports.releases.file_runner import FileRunner
from app.exports.releases.file_work_chore import expire_exports
from app.people.access.secret_box import SecretBox
from app.people.models import Participant
from app.people.privacy_models import AuditEvent, BlobDeletion
from app.privacy.delete_blobs import BlobDeleter
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.meals.upload.answers import refusal
from tests.integration.people.people import make_staff
from tests.support.stores import make_old, stored_names

PATH = "/v1/studies/pilot/exports"


@pytest.fixture
def eaten(enrol, state):
    """Meals of two participants: their ids on the phone."""
    phones = {code: enrol(code) for code in ("P001", "P002")}
    first = add_meal(state, "P001", "2026-11-01", eaten_item(100.0, "apple", energy_kcal=52.0))
    second = add_meal(state, "P002", "2026-11-02", eaten_item(50.0, "banana"), eaten_item(None))
    return {"phones": phones, "P001": first, "P002": second}


@pytest.fixture
def viewer(client, admin, eaten):
    return make_staff(client, admin, "vera", pilot="viewer")


def ask(person, **body):
    return person.post(PATH, json={"rows": "items", "format": "csv"} | body)


def made(person, run, **body):
    """An export that is done, as the API shows it."""
    path = ask(person, **body).headers["location"]
    assert run().outcome == "done"
    return person.get(path).json()


def events(state, action):
    with state.database.read() as session:
        return session.scalars(sa.select(AuditEvent).where(AuditEvent.action == action)).all()


@pytest.mark.parametrize("output", ["csv", "parquet"])
def test_file_made_in_the_background_is_the_one_that_is_streamed(viewer, run, state, output):
    answer = ask(viewer, format=output)
    assert answer.status_code == 202
    assert answer.json()["state"] == "queued"
    assert refusal(viewer.get(answer.headers["location"] + "/file")) == (409, "export_not_ready")
    assert run().outcome == "done"
    export = viewer.get(answer.headers["location"]).json()
    assert (export["state"], export["rows_written"], export["rows_estimated"]) == ("done", 3, 3)
    fetched, streamed = viewer.get(export["file"]), viewer.get(f"/v1/records?study=pilot&format={output}")
    assert fetched.content == streamed.content
    assert fetched.headers["content-type"] == streamed.headers["content-type"]
    assert export["sha256"] == hashlib.sha256(fetched.content).hexdigest()
    assert export["bytes"] == len(fetched.content) == int(fetched.headers["content-length"])
    assert f'filename="pilot_records.{output}"' in fetched.headers["content-disposition"]
    assert export["asked_by"] == "vera"
    assert run() is None
    assert [event.actor for event in events(state, "export.request")] == ["vera"]
    assert [event.actor for event in events(state, "export.download")] == ["vera"]


def test_filters_leave_the_same_rows_as_the_pages(viewer, run):
    export = made(viewer, run, format="ndjson", filters={"participant": "P002", "from": "2026-11-02"})
    lines = [json.loads(line) for line in viewer.get(export["file"]).content.splitlines()]
    pages = viewer.get("/v1/records?study=pilot&participant=P002&from=2026-11-02").json()["items"]
    assert [line["id"] for line in lines] == [row["id"] for row in pages]
    assert len(lines) == 2
    assert export["filters"] == {"participant": "P002", "from": "2026-11-02"}


def test_impossible_export_is_refused_at_once(viewer):
    for body, code in (
        ({"rows": "photographs", "layout": "long"}, "export_not_offered"),
        ({"rows": "days", "format": "geojson"}, "export_not_offered"),
        ({"filters": {"from": "2026-11-03", "to": "2026-11-02"}}, "days_reversed"),
        ({"rows": "everything"}, "invalid_input"),
        ({"filters": {"status": ["eaten"]}}, "invalid_input"),
        ({"filters": {"colour": "red"}}, "invalid_input"),
        ({"filters": {"participant": "\0"}}, "invalid_input"),
    ):
        assert refusal(ask(viewer, **body)) == (422, code), body
    assert viewer.get(PATH).json()["items"] == []


def test_interrupted_download_resumes_and_a_range_that_is_none_gives_the_whole_file(viewer, run):
    export = made(viewer, run)
    whole = viewer.get(export["file"])
    etag, length = whole.headers["etag"], len(whole.content)
    assert etag == f'"{export["sha256"]}"'
    rest = viewer.get(export["file"], headers={"Range": "bytes=100-", "If-Range": etag})
    assert rest.status_code == 206
    assert rest.headers["content-range"] == f"bytes 100-{length - 1}/{length}"
    assert whole.content[:100] + rest.content == whole.content
    for header, expected in {
        "bytes=0-0": whole.content[:1],
        "bytes=10-19": whole.content[10:20],
        "bytes=-7": whole.content[-7:],
        f"bytes=5-{length + 1000}": whole.content[5:],
        f"bytes=-{length + 1000}": whole.content,
    }.items():
        part = viewer.get(export["file"], headers={"Range": header})
        assert (part.status_code, part.content) == (206, expected), header
    for headers in (
        {"Range": "bytes=5-3"},
        {"Range": "bytes=-"},
        {"Range": "lines=1-2"},
        {"Range": "bytes=0-1,4-5"},
        {"Range": "bytes=3-", "If-Range": '"another"'},
        {"Range": "bytes=3-", "If-Range": "Sat, 21 Nov 2026 10:00:00 GMT"},
    ):
        answer = viewer.get(export["file"], headers=headers)
        assert (answer.status_code, answer.content) == (200, whole.content), headers
    for header in (f"bytes={length}-", "bytes=-0"):
        answer = viewer.get(export["file"], headers={"Range": header})
        assert refusal(answer) == (416, "range_not_satisfiable")
        assert answer.headers["content-range"] == f"bytes */{length}"
    known = viewer.get(export["file"], headers={"If-None-Match": etag})
    assert (known.status_code, known.content) == (304, b"")


def test_repeated_request_is_the_same_export_until_it_is_done_and_too_many_are_refused(client, admin, viewer, run):
    first, again = ask(viewer), ask(viewer)
    assert (first.status_code, again.status_code) == (202, 200)
    assert first.json()["id"] == again.json()["id"]
    other = make_staff(client, admin, "otto", pilot="viewer")
    assert ask(other).json()["id"] != first.json()["id"]
    assert run().outcome == run().outcome == "done"
    answers = [ask(viewer, format=output) for output in ("csv", "ndjson", "parquet", "geojson")]
    assert [answer.status_code for answer in answers] == [202, 202, 202, 429]
    assert (*refusal(answers[3]), answers[3].json()["limit"]) == (429, "too_many_exports", MOST_OF_PERSON)
    assert viewer.delete(answers[0].headers["location"]).status_code == 204
    assert ask(viewer, format="geojson").status_code == 202


def test_exports_are_listed_newest_first_in_pages(viewer, run):
    paths = []
    for output in ("csv", "ndjson", "parquet"):
        paths.append(ask(viewer, format=output).json()["id"])
        run()
    listed, path = [], f"{PATH}?limit=2"
    while path:
        page = viewer.get(path).json()
        listed += [row["id"] for row in page["items"]]
        path = page["next"]
    assert listed == paths[::-1]


def test_export_does_not_exist_without_access_to_its_study(client, admin, viewer, run):
    export = made(viewer, run)
    assert client.delete("/v1/studies/pilot/members/vera", headers=admin).status_code == 204
    assert viewer.get(export["file"]).status_code == 404
    client.post("/v1/studies", headers=admin, json={"code": "other", "name": "other"})
    elsewhere = f"/v1/studies/other/exports/{export['id']}"
    for path in (elsewhere, elsewhere + "/file"):
        assert client.get(path, headers=admin).status_code == 404


def test_only_the_requester_or_an_owner_removes_an_export_with_its_file(client, admin, viewer, run, state):
    export = made(viewer, run)
    path = f"{PATH}/{export['id']}"
    other = make_staff(client, admin, "otto", pilot="reviewer")
    assert refusal(other.delete(path)) == (403, "export_of_another")
    owner = make_staff(client, admin, "olga", pilot="owner")
    assert owner.delete(path).status_code == 204
    assert owner.get(path).status_code == 404
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert not [name for name in stored_names(state.blobs) if "/exports/" in name]
    assert [event.details["was"] for event in events(state, "export.remove")] == ["done"]


def test_cancelled_export_is_not_made_and_later_deleted(viewer, run):
    path = ask(viewer).headers["location"]
    assert viewer.delete(path).status_code == 204
    assert viewer.get(path).json()["state"] == "cancelled"
    assert viewer.get(path + "/file").json()["code"] == "export_cancelled"
    assert run() is None
    assert viewer.delete(path).status_code == 204
    assert viewer.get(path).status_code == 404


def test_file_is_no_orphan_expires_after_a_week_and_its_row_is_deleted_a_month_later(viewer, run, state):
    export = made(viewer, run)
    path = f"{PATH}/{export['id']}"
    make_old(state.blobs)
    assert BlobDeleter(state.database, state.blobs).delete_orphans() == 0
    assert viewer.get(export["file"]).status_code == 200
    assert expire_exports(state.database) == 0
    week = datetime.now(UTC) + timedelta(days=7, seconds=1)
    assert expire_exports(state.database, week) == 1
    assert refusal(viewer.get(path + "/file")) == (410, "export_expired")
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert not [name for name in stored_names(state.blobs) if "/exports/" in name]
    expire_exports(state.database, week + timedelta(days=31))
    assert viewer.get(path).status_code == 404


@pytest.fixture
def during(monkeypatch):
    """Do something once after a file was written, before it counts."""

    def during(action):
        run, done = FileTasks.run, []

        def run_and_act(*args, **kwargs):
            answer = run(*args, **kwargs)
            if not done:
                done.append(True)
                action()
            return answer

        monkeypatch.setattr(FileTasks, "run", run_and_act)

    return during


def test_meal_erased_while_the_file_is_written_is_in_no_file(viewer, run, state, eaten, during):
    path = ask(viewer).headers["location"]
    phone = eaten["phones"]["P001"]
    during(lambda: phone.client.delete(f"/v1/meals/{eaten['P001']}", headers=phone.headers))
    assert run().outcome in ("lost", "again")
    assert viewer.get(path).json()["state"] == "queued"
    assert not [name for name in stored_names(state.blobs) if "/exports/" in name or "made-" in name]
    assert run().outcome == "done"
    rows = list(csv.DictReader(io.StringIO(viewer.get(path + "/file").text)))
    assert {row["participant"] for row in rows} == {"P002"}


def test_erasure_that_commits_before_the_claim_is_seen_is_found_by_the_last_transaction(
    viewer, run, state, eaten, during, monkeypatch
):
    """Of an export that was still queued when the erasure looked, and whose snapshot is of before its commit."""
    path = ask(viewer).headers["location"]
    phone = eaten["phones"]["P001"]
    monkeypatch.setattr(exports, "erase_from_exports", lambda *_: 0)
    during(lambda: phone.client.delete(f"/v1/meals/{eaten['P001']}", headers=phone.headers))
    assert run().outcome == "again"
    assert viewer.get(path).json()["state"] == "queued"
    assert run().outcome == "done"
    assert "P001" not in viewer.get(path + "/file").text


@pytest.mark.parametrize("policy", ["erase", "anonymise", "keep"])
def test_withdrawal_expires_files_with_the_participant_and_deletes_exports_that_name_them_unless_data_are_kept(
    client, admin, viewer, run, state, eaten, policy
):
    tag = client.get("/v1/studies/pilot", headers=admin).headers["etag"]
    body = {"withdrawal_policy": policy}
    assert client.patch("/v1/studies/pilot", headers=admin | {"If-Match": tag}, json=body).status_code == 200
    export = made(viewer, run)
    named = made(viewer, run, filters={"participant": "P001"})
    assert client.post("/v1/me/withdrawal", headers=eaten["phones"]["P001"].headers).status_code == 200
    answer = viewer.get(export["file"])
    if policy == "keep":
        assert "P001" in answer.text
        return
    assert refusal(answer) == (410, "export_expired")
    assert viewer.get(f"{PATH}/{named['id']}").status_code == 404
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert not [name for name in stored_names(state.blobs) if "/exports/" in name]
    with state.database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(BlobDeletion)) == 0
        assert "P001" not in str([row.spec for row in session.scalars(sa.select(Export))])


def test_export_cancelled_while_it_is_written_leaves_nothing(viewer, run, state, during):
    path = ask(viewer).headers["location"]
    during(lambda: viewer.delete(path))
    assert run().outcome == "lost"
    assert viewer.get(path).json()["state"] == "cancelled"
    assert not [name for name in stored_names(state.blobs) if "/exports/" in name or "made-" in name]


def test_runner_that_died_is_taken_over_and_writes_nothing_when_it_comes_back(viewer, run, state, during):
    path = ask(viewer).headers["location"]

    def take_over():
        assert run().outcome == "done"  # by another, since the lease of no time at all has run out

    sleeping = FileRunner(
        state.database, state.blobs, state.settings, state.part(SecretBox), uuid.uuid4(), beat_seconds=3600.0
    )
    during(lambda: run_over_dead_lease(state, take_over))
    assert sleeping.run_one().outcome == "lost"
    export = viewer.get(path).json()
    assert export["state"] == "done"
    assert hashlib.sha256(viewer.get(path + "/file").content).hexdigest() == export["sha256"]
    assert len([name for name in stored_names(state.blobs) if "/exports/" in name]) == 1


def run_over_dead_lease(state, action):
    with state.database.write() as session:
        long_ago = datetime.now(UTC) - timedelta(seconds=file_work.LEASE_SECONDS + 60)
        session.execute(sa.update(Export).values(heartbeat_at=long_ago))
    action()


@pytest.mark.both_stores
def test_living_runner_is_not_taken_over(viewer, run, during):
    ask(viewer)
    others = []
    during(lambda: others.append(run()))
    assert run().outcome == "done"
    assert others == [None]


def test_future_heartbeat_does_not_keep_a_claim_alive(viewer, run, state):
    """The database's clock went back: who died before would else be taken for alive until it has caught up."""
    ask(viewer)
    with state.database.write() as session:
        file_work.claim_next(session, uuid.uuid4())
        session.execute(sa.update(Export).values(heartbeat_at=datetime.now(UTC) + timedelta(days=1)))
    assert run().outcome == "done"


def test_transient_fault_is_retried_and_a_lasting_one_fails_the_export(viewer, run, state, monkeypatch):
    path = ask(viewer).headers["location"]

    def broken(*_, **__):
        raise ConnectionError("the store is away")

    with monkeypatch.context() as patch:
        patch.setattr(FileTasks, "run", broken)
        for attempt in range(file_runner.MOST_ATTEMPTS):
            assert viewer.get(path).json()["state"] == "queued", attempt
            with state.database.write() as session:
                assert file_work.has_work(session) == (attempt == 0)  # else it waits for a while first
                session.execute(sa.update(Export).values(begin_after=None))
            run()
    export = viewer.get(path).json()
    assert (export["state"], export["failure"]) == ("failed", "internal_error")
    assert viewer.get(path + "/file").json()["code"] == "export_failed"
    assert run() is None
    path = ask(viewer, format="ndjson").headers["location"]
    monkeypatch.setattr("app.exports.file_task.shutil.disk_usage", lambda _: type("Usage", (), {"free": -1}))
    assert run().outcome == "storage_full"
    assert viewer.get(path).json()["failure"] == "storage_full"


def test_runner_that_dies_each_time_fails_the_export(viewer, run, state):
    path = ask(viewer).headers["location"]
    for _ in range(file_runner.MOST_ATTEMPTS):
        claim = uuid.uuid4()
        with state.database.write() as session:
            assert file_work.claim_next(session, claim) is not None
            assert file_work.put_back(session, claim, counts=True) == 1
    assert run().outcome == "export_gave_up"
    assert viewer.get(path).json()["failure"] == "export_gave_up"


def test_erasures_are_counted_unless_they_remove_no_row(client, admin, enrol, state, eaten):
    with state.database.read() as session:
        study_id = session.scalar(sa.select(Participant.study_id).limit(1))
        before = exports.moment_of(session, study_id)
    phone = eaten["phones"]["P001"]
    phone.client.delete(f"/v1/meals/{eaten['P001']}", headers=phone.headers)
    with state.database.read() as session:
        after = exports.moment_of(session, study_id)
    assert (after.erasures, after.change_seq > before.change_seq) == (before.erasures + 1, True)
