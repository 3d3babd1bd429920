"""`tada doctor` finds each fault that is really there, says what to do, and is content where nothing is wrong."""

import hashlib
import json
import os
import socket
import uuid
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.core.settings import Settings
from app.db.migrate import downgrade
from app.db.schema_state import current_revision, revisions
from app.db.session import Database, PoolLimits
from app.exports.release_models import Release, ReleaseFile
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.operations.backup.write_backup import note_backup
from app.operations.doctor import doctor_data
from app.operations.doctor.doctor import examine
from app.outbox.models import Webhook, WebhookDelivery
from app.people.access.secret_box import SecretBox, open_secret_box
from app.people.models import Staff, Study
from app.people.privacy_models import AuditEvent, BlobDeletion, Tombstone
from app.privacy.erasure_ledger import Erasure, ErasureLedger
from app.storage.opening import open_blob_store
from tests.conftest import s3_settings
from tests.integration.jobs.fakes import new_meal, new_unqueued_job
from tests.support.commands import run_tada

KEY = "a key for tests only, of no worth"
OTHER_KEY = "another key for tests, of no worth"


class Deployment:
    """A deployment without a server, and what the doctor says of it."""

    def __init__(self, url, folder, kind):
        self.settings = Settings(
            database_url=url,
            data_dir=folder / "data",
            secret_key=KEY,
            erasure_url=f"file://{folder / 'ledger'}",
            min_free_bytes=0,
        )
        for made in (folder, self.settings.data_dir):  # as the program's own umask makes them
            made.mkdir(mode=0o700, exist_ok=True)
            made.chmod(0o700)
        self.kind = kind
        self.database = Database(url)
        self.blobs = open_blob_store(self.settings.resolved_blob_url, self.settings)

    def findings(self, *, requeue=False, **changes):
        settings = Settings(**(self.settings.model_dump() | changes))
        return {one.subject: one for one in examine(self.database, settings, requeue=requeue)}

    def bad(self, **changes):
        """What is wrong, besides what is wrong with every deployment of these tests."""
        expected = {"workers"} | ({"durability"} if self.kind == "postgres" else set())
        found = {subject: one for subject, one in self.findings(**changes).items() if not one.is_ok}
        assert expected <= set(found) or "schema" in found or "database" in found
        assert all(one.advice for one in found.values() if one.subject != "secret key")
        return {subject: one.message for subject, one in found.items() if subject not in expected}

    def add(self, *rows):
        with self.database.write() as session:
            for row in rows:
                session.add(row)
                session.flush()

    def run_sql(self, text):
        with self.database.write() as session:
            session.execute(sa.text(text))

    def photograph(self, content=b"a photograph"):
        """A meal's photograph, sealed and named. Its key."""
        digest = sha256(content)
        with self.database.write() as session:
            meal = new_meal(session)
            meal.status = "estimated"
            key = f"{meal.study_id}/{meal.id}/left/{digest}"
            session.add(
                MealImage(
                    id=uuid.uuid4(),
                    meal_id=meal.id,
                    slot="left",
                    media_type="image/jpeg",
                    width_px=1,
                    height_px=1,
                    bytes=len(content),
                    received_sha256=digest,
                    stored_sha256=digest,
                    blob_key=key,
                    received_at=datetime.now(UTC),
                )
            )
        self.blobs.put_bytes(key, content)
        return key


def sha256(content):
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def deployment(prepared_database_url, tmp_path, kind):
    (tmp_path / "data").mkdir()
    found = Deployment(prepared_database_url, tmp_path, kind)
    yield found
    found.database.dispose()


def test_sound_deployment_without_workers_lacks_workers_only(deployment):
    deployment.photograph()
    note_backup(deployment.database, blobs=1, damaged=0)
    assert deployment.bad() == {}
    found = deployment.findings()
    assert found["photographs"].message == "all 1 are in the store"
    assert found["newest photographs"].message == "1 read back, bit for bit"
    assert found["schema"].level == found["clock"].level == "ok"
    assert found["ledger of erasures"].level == "note"  # the tests' folders lie on one disk
    assert found["backup"].message == "the last `tada backup` is 0 h old"
    assert found["sqlite file"].level == "ok"


def test_database_that_is_away_is_told_and_the_rest_is_looked_at(deployment, tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    for url in (
        f"sqlite:///{tmp_path / 'nowhere.sqlite3'}",
        f"postgresql://nobody:hunter2hunter2@127.0.0.1:{port}/none",
    ):
        away = Database(url)
        found = {one.subject: one for one in examine(away, deployment.settings, requeue=False)}
        away.dispose()
        assert not found["database"].is_ok
        assert "hunter2" not in found["database"].message
        assert found["blob store"].is_ok
        assert "queue" not in found
    assert not (tmp_path / "nowhere.sqlite3").exists()


def test_newer_schema_is_a_note_and_an_older_one_is_bad_and_its_tables_are_not_asked(deployment, next_migration):
    deployment.run_sql("UPDATE alembic_version SET version_num = 'of_tomorrow'")
    assert deployment.findings()["schema"].level == "note"  # an upgrade is under way
    assert "schema" not in deployment.bad()
    deployment.run_sql(f"UPDATE alembic_version SET version_num = '{revisions()[-1]}'")
    next_migration()
    bad = deployment.bad()
    assert list(bad) == ["schema"]
    assert revisions()[-1] in bad["schema"]


def test_missing_secret_key_is_a_note_and_a_readable_key_file_is_told(deployment):
    assert deployment.findings(secret_key=None)["secret key"].level == "note"
    settings = Settings(**(deployment.settings.model_dump() | {"secret_key": None}))
    open_secret_box(settings)
    (settings.data_dir / "secret.key").chmod(0o644)
    assert "secret key" in deployment.bad(secret_key=None)


@pytest.mark.parametrize("kind", ["postgres"])
def test_postgres_without_key_durability_connections_or_options_is_told(deployment):
    assert "TADA_SECRET_KEY" in deployment.bad(secret_key=None)["secret key"]
    found = deployment.findings()["durability"]  # the tests' own server runs so
    assert not found.is_ok
    for name in ("fsync", "synchronous_commit", "full_page_writes"):
        assert name in found.message
    for limits, subject, words in (
        (PoolLimits(size=500), "connections", "may want"),
        (PoolLimits(statement_seconds=0), "connection", "do not arrive"),
    ):
        deployment.database.dispose()
        deployment.database = Database(deployment.settings.database_url, limits)
        assert words in deployment.bad()[subject]


def test_data_folder_that_others_may_look_into_is_told(deployment):
    """Older versions left it to the umask: the SQLite file was readable by every local user."""
    assert deployment.findings()["private files"].level == "ok"
    deployment.settings.data_dir.chmod(0o755)
    assert "private files" in deployment.bad()


def test_store_that_cannot_be_written_and_a_full_disk_are_told(deployment, tmp_path):
    (tmp_path / "file").touch()
    assert "Not a directory" in deployment.bad(blob_url=f"file://{tmp_path / 'file' / 'blobs'}")["blob store"]
    assert "no meal is accepted" in deployment.bad(min_free_bytes=1 << 60)["disk"]


def test_altered_or_missing_photograph_is_named_and_an_erased_one_is_not_missing(deployment):
    key = deployment.photograph()
    assert not {"photographs", "newest photographs"} & set(deployment.bad())
    deployment.blobs.put_bytes(key, b"other bytes of it")
    assert key in deployment.bad()["newest photographs"]
    deployment.blobs.delete(key)
    assert key in deployment.bad()["photographs"]
    with deployment.database.write() as session:
        session.execute(sa.update(MealImage).values(erased_at=datetime.now(UTC)))
    assert deployment.findings()["photographs"].message == "all 0 are in the store"


def test_failures_of_the_server_are_told_by_code_and_those_of_photographs_are_not_wrong(deployment):
    def fail(code):
        with deployment.database.write() as session:
            new_meal(session).status = "failed"
            session.flush()
            session.execute(sa.update(Meal).where(Meal.failure_code.is_(None)).values(failure_code=code))

    fail("marker_not_found")
    assert "failed meals" not in deployment.bad()
    fail("internal_error")
    assert deployment.bad()["failed meals"] == "because of the server, in 7 days: internal_error 1."


def test_meal_that_nothing_moves_and_an_old_queue_are_told_and_requeued(deployment):
    with deployment.database.write() as session:
        job, _ = new_unqueued_job(session)
        job.enqueued_at = datetime.now(UTC) - timedelta(hours=1)
        new_meal(session)  # without a job
    bad = deployment.bad()
    assert bad["meals"] == "1 are stuck."
    assert "the oldest has waited 36" in bad["queue"]
    assert "1 queued again or failed" in deployment.findings(requeue=True)["meals"].message
    assert "meals" not in deployment.bad()
    with deployment.database.write() as session:
        session.execute(sa.update(Job).values(faulty_since=datetime.now(UTC)))
    assert deployment.bad()["queue"].endswith("; 2 wait for a fault to pass.")


def new_release(name, requested_at, state, **values):
    """A release of a study of its own, with who asked for it."""
    study = Study(id=uuid.uuid4(), code=f"study-{name}", name="s", created_at=requested_at)
    staff = Staff(id=uuid.uuid4(), name=f"olga of {name}", is_admin=False, created_at=requested_at)
    release = Release(
        id=uuid.uuid4(),
        study_id=study.id,
        staff_id=staff.id,
        name=name,
        note="",
        filters={},
        state=state,
        requested_at=requested_at,
        former_checksums=[],
        **values,
    )
    return study, staff, release


def test_release_that_waits_too_long_and_one_that_cannot_be_changed_are_told(deployment):
    now = datetime.now(UTC)
    assert deployment.findings()["exports and releases"].message == "none waits"
    deployment.add(*new_release("young", now - timedelta(minutes=1), "queued"))
    found = deployment.findings()["exports and releases"]
    assert (found.level, found.message.startswith("1 releases queued; the oldest has waited 6")) == ("ok", True)
    deployment.add(*new_release("old", now - timedelta(hours=2), "running"))
    assert deployment.bad()["exports and releases"].startswith("1 releases queued, 1 releases running; the oldest")
    assert "releases that must change" not in deployment.findings()
    deployment.add(*new_release("lost", now, "changing", failure_code="release_files_missing"))
    said = "1 cannot be rewritten without erased data, and are not served: study-lost lost (release_files_missing)."
    assert deployment.bad()["releases that must change"] == said


def test_file_of_a_release_that_is_missing_is_named_before_anything_must_change_it(deployment):
    study, staff, release = new_release("baseline", datetime.now(UTC), "ready")
    key = f"made_/releases/{study.id}/{release.id}/{uuid.uuid4().hex}/items.csv/{sha256(b'rows')}"
    file = ReleaseFile(release_id=release.id, name="items.csv", rows=1, bytes=4, sha256=sha256(b"rows"), blob_key=key)
    deployment.blobs.put_bytes(key, b"rows")
    deployment.add(study, staff, release, file)
    assert deployment.findings()["files of releases"].message == "all 1 are in the store"
    deployment.blobs.delete(key)
    assert key in deployment.bad()["files of releases"]


@pytest.mark.both_stores
def test_clocks_that_are_apart_and_events_of_the_future_are_told(deployment, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(doctor_data, "database_now", lambda _: datetime.now(UTC) + timedelta(seconds=60))
        assert "60 s apart" in deployment.bad()["clock"]
    add_event(deployment, "test", days_ago=-1)
    assert "is in the future" in deployment.bad()["clock"]


def test_sqlite_on_a_network_file_system_is_told(deployment, tmp_path, monkeypatch):
    mounts = tmp_path / "mountinfo"
    mounts.write_text(
        "21 1 8:1 / / rw,relatime - ext4 /dev/sda1 rw\n"
        f"22 21 0:50 / {tmp_path} rw,relatime shared:1 - nfs4 server:/export rw\n"
    )
    monkeypatch.setattr(doctor_data, "MOUNTS", mounts)
    assert doctor_data.file_system_of(tmp_path / "data" / "tada.sqlite3") == "nfs4"
    assert doctor_data.file_system_of(tmp_path.parent) == "ext4"
    assert "nfs4" in deployment.bad()["sqlite file"]


def test_ledger_beside_what_it_is_to_outlive_is_a_note_and_one_that_cannot_be_written_is_wrong(
    deployment, monkeypatch, tmp_path
):
    subject = "ledger of erasures"
    assert deployment.findings(erasure_url=None)[subject].level == "note"
    disks = {"ledger": 1, "data": 2, "tada.sqlite3": 3}
    monkeypatch.setattr(doctor_data, "disk_of", lambda path: disks[path.relative_to(tmp_path).parts[0]])
    assert deployment.findings()[subject].level == "ok"
    for beside in ("data", "tada.sqlite3"):
        with monkeypatch.context() as patch:
            patch.setitem(disks, "ledger", disks[beside])
            found = deployment.findings()[subject]
            assert (found.level, "a disk that dies takes both" in found.message) == ("note", True)
    (tmp_path / "file").touch()
    disks["file"] = 4
    assert "Nobody can be erased" in deployment.bad(erasure_url=f"file://{tmp_path}/file/l")[subject]


def test_ledger_in_the_photographs_bucket_is_a_note(deployment, s3_server):
    store = s3_settings(s3_server)
    subject = "ledger of erasures"
    found = deployment.findings(**store, erasure_url=None)[subject]
    assert (found.level, "takes both" in found.message) == ("note", True)
    s3_server.make_bucket("ledgers")
    assert deployment.findings(**store, erasure_url="s3://ledgers/erasures")[subject].level == "ok"


def test_metrics_without_a_token_behind_a_proxy_are_a_note(deployment):
    for changes in ({"public_url": "https://tada.example.org"}, {"trusted_proxies": "127.0.0.1"}):
        assert deployment.findings(**changes)["metrics"].level == "note"
        assert "metrics" not in deployment.findings(**changes, metrics_token="a token for tests of metrics")
    assert "metrics" not in deployment.findings()


def erasure(box):
    digest = box.digest("meal", str(uuid.uuid4()))
    return Erasure(kind="meal", policy="erase", digest=digest, receipt_id=uuid.uuid4(), at=datetime.now(UTC))


def test_erasure_that_was_not_carried_out_and_one_that_the_ledger_lacks_are_told(deployment, monkeypatch):
    box = SecretBox(KEY)
    noted, lost = erasure(box), erasure(box)
    store = open_blob_store(deployment.settings.resolved_erasure_url, deployment.settings)
    ErasureLedger(store, box).write(noted)
    assert "erasures" not in deployment.bad()  # it may be under way
    monkeypatch.setattr(doctor_data, "UNDER_WAY", timedelta(seconds=-60))
    assert deployment.bad()["erasures"].startswith("1 promised erasures")
    assert "TADA_SECRET_KEY" in deployment.bad(secret_key=OTHER_KEY)["erasures"]
    deployment.add(Tombstone(kind="meal", digest=noted.digest, study_id=None, erased_at=noted.at))
    assert not {"erasures", "ledger's entries"} & set(deployment.bad())
    # the ledger was moved, or came back with a restore: a backup would bring back whom it lacks
    deployment.add(Tombstone(kind="meal", digest=lost.digest, study_id=None, erased_at=lost.at))
    assert deployment.findings()["ledger's entries"].message.startswith("it lacks 1 erasures")


def test_blob_that_should_be_gone_is_told(deployment):
    now = datetime.now(UTC)
    deployment.add(BlobDeletion(blob_key="a/b/left/young", requested_at=now))
    assert "erasures" not in deployment.bad()
    deployment.add(BlobDeletion(blob_key="a/b/left/old", requested_at=now - timedelta(hours=2)))
    assert "1 blobs still have to be deleted" in deployment.bad()["erasures"]


def webhook(deployment, key=KEY, **changes):
    now = datetime.now(UTC)
    study = Study(id=uuid.uuid4(), code=uuid.uuid4().hex, name="s", created_at=now)
    hook = Webhook(
        id=uuid.uuid4(),
        study_id=study.id,
        url="https://example.org/hook",
        events=["*"],
        secret_sealed=SecretBox(key).seal("whsec_of_a_test"),
        author="a test",
        version=1,
        created_at=now,
        **changes,
    )
    deployment.add(study, hook)
    return hook


def test_receiver_that_fails_a_disabled_webhook_and_a_secret_of_another_key_are_told(deployment):
    now = datetime.now(UTC)
    hook = webhook(deployment, disabled_at=now)
    assert deployment.findings()["webhooks"].level == "note"
    fields = {"event": "meal.estimated", "payload": {}, "state": "waiting", "attempts": 4}
    deployment.add(WebhookDelivery(id=uuid.uuid4(), webhook_id=hook.id, next_try_at=now, created_at=now, **fields))
    bad = deployment.bad()
    assert bad["webhooks"].startswith("1 deliveries failed")
    assert "webhooks' secrets" not in bad
    webhook(deployment, key=OTHER_KEY)
    assert "not the key" in deployment.bad()["webhooks' secrets"]


def test_backup_that_is_old_or_lacks_blobs_is_bad_and_one_that_went_to_a_pipe_is_a_note(deployment):
    def finding():
        found = deployment.findings()["backup"]
        return found.level, found.message

    assert finding() == ("note", "no `tada backup` of this database is known.")
    add_event(deployment, "backup.make", days_ago=3)
    last = "the last `tada backup` is"
    assert finding() == ("bad", f"{last} 72 h old.")
    note_backup(deployment.database, blobs=7, damaged=0, piped=True)
    piped = f"{last} 0 h old, and was sent to a pipe: whether it was stored is not known here."
    assert finding() == ("note", piped)
    assert "tada restore --check" in deployment.findings()["backup"].advice
    note_backup(deployment.database, blobs=5, damaged=2)
    assert finding() == ("bad", f"{last} 0 h old, and lacks 2 blobs that were damaged or missing.")
    note_backup(deployment.database, blobs=7, damaged=0)
    assert finding()[0] == "ok"


def add_event(deployment, action, days_ago):
    at = datetime.now(UTC) - timedelta(days=days_ago)
    deployment.add(AuditEvent(at=at, actor_kind="system", actor="system", action=action, details={}))


@pytest.mark.parametrize(("days", "level", "more"), [(1, "note", ""), (3, "bad", ", and it has been in use for 72 h")])
def test_backup_that_never_was_is_bad_once_the_deployment_is_two_days_old(deployment, days, level, more):
    add_event(deployment, "staff.create", days_ago=days)
    found = deployment.findings()["backup"]
    assert (found.level, found.message) == (level, f"no `tada backup` of this database is known{more}.")


def test_part_that_cannot_be_asked_is_a_finding_and_hides_no_other(deployment, monkeypatch):
    def broken(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(doctor_data, "find_missing", broken)
    bad = deployment.bad()
    assert bad["photographs"] == "the check failed (OSError)."
    assert "backup" in deployment.findings()


def test_command_tells_findings_as_json_and_says_no(deployment):
    done = run_tada("doctor", "--json", **variables(deployment))
    assert done.returncode == 1
    findings = {one["subject"]: one for one in json.loads(done.stdout)["findings"]}
    message = "none: meals are stored but not estimated."
    advice = "Start `tada worker`."
    assert findings["workers"] == {"subject": "workers", "level": "bad", "message": message, "advice": advice}
    told = run_tada("doctor", **variables(deployment)).stdout
    assert "BAD  workers: none: meals are stored but not estimated. Start `tada worker`." in told.splitlines()


@pytest.mark.both_stores
def test_command_migrates_nothing(deployment):
    downgrade(deployment.database, "base")
    assert run_tada("doctor", **variables(deployment)).returncode == 1
    assert current_revision(deployment.database) is None


def variables(deployment):
    settings = deployment.settings
    return {
        "TADA_DATABASE_URL": settings.database_url,
        "TADA_DATA_DIR": os.fspath(settings.data_dir),
        "TADA_SECRET_KEY": KEY,
        "TADA_ERASURE_URL": settings.erasure_url,
    }
