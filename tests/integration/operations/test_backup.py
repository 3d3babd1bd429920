"""A backup restored on an empty machine is the same deployment: every row, every byte, every answer."""

import contextlib
import csv
import errno
import json
import math
import threading
import uuid
from datetime import UTC, datetime, timedelta

import obstore
import pyarrow as pa
import pytest
import sqlalchemy as sa

from app.core.errors import InvalidInputError, StorageFullError
from app.db.base import Base, UtcDateTime
from app.db.migrate import upgrade
from app.db.schema_state import current_revision, head_revision
from app.foods.models import Food
from app.jobs import queries as jobs
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import RunArtefact
from app.operations.backup import restore as restore_module
from app.operations.backup.restore import CHANGE_SEQ_JUMP
from app.operations.backup.table_files import TRANSIENT_TABLES, schema_of, tables_at
from app.operations.backup.write_backup import write_backup
from app.operations.queries import last_backup
from app.people.access.last_use import LastUse
from app.people.access.secret_box import SecretKeyError
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.retention import erase_old_pictures
from app.records.recompute_records import rebuild_records
from app.storage.blob_store import StoreRefusesError
from tests.conftest import postgres_database, s3_settings
from tests.integration.conftest import meal_metadata
from tests.integration.operations.deployments import Deployment, deployment, estimate, named_blobs, store_what_is_named
from tests.integration.people.persons import Person
from tests.support.photographs import pair
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

LARGE = ("food_posting", "food_word_trigram", "food_nutrient", "food_code", "food_density", "food_portion")


@pytest.fixture
def source(state, settings) -> Deployment:
    """The deployment that the tests' phones send to, with a food table that is quick to copy."""
    with state.database.write() as session:
        apple = session.scalar(sa.select(Food.id).where(Food.key == "apple"))
        for table in LARGE:
            of_apple = "food_id = :apple" if table != "food_word_trigram" else "word LIKE 'apple%'"
            session.execute(sa.text(f"DELETE FROM {table} WHERE NOT ({of_apple})"), {"apple": apple})
    return Deployment(settings, state.database, state.blobs)


@pytest.fixture
def empty_machine(request, tmp_path):
    """empty_machine("sqlite"): a new folder, a new database without tables, a new store."""
    with contextlib.ExitStack() as stack:

        def make(kind_of_database, **settings):
            folder = tmp_path / f"machine-{len(list(tmp_path.iterdir()))}"
            folder.mkdir()
            url = f"sqlite:///{folder / 'tada.sqlite3'}"
            if kind_of_database == "postgres":
                url = stack.enter_context(postgres_database(request.getfixturevalue("postgres_server")))
            return stack.enter_context(deployment(folder, url, **settings))

        yield make


@pytest.fixture
def person(state, enrol, source):
    """Somebody who has a row in every table that can hold one of theirs, and the blobs that they name."""
    person = Person(state, enrol, "somebody-7Kq", seed=3)
    state.part(LastUse).settle()
    store_what_is_named(source.database, source.blobs)
    with state.database.write() as session:
        session.execute(sa.update(DiaryDay).values(change_seq=1))  # changes count from 1
    return person


def later(rows):
    """Rows as a restore makes them: every change has a later number."""

    def changed(row):
        number = row.get("change_seq")
        return row if number is None else row | {"change_seq": number + CHANGE_SEQ_JUMP}

    return {table: {key: changed(row) for key, row in of_table.items()} for table, of_table in rows.items()}


def without_note(rows):
    """Rows but the restore's own event in the audit log."""
    events = {key: row for key, row in rows["audit_event"].items() if row["action"] != "server.restore"}
    assert len(rows["audit_event"]) == len(events) + 1
    return rows | {"audit_event": events}


def answers(client, headers, person, jump=0):
    """What researchers and the phone are told; change numbers less the jump, cursors, which hold them, left out."""
    told = {}
    for path, params in (
        ("/v1/records", {"limit": 1000}),
        ("/v1/days", {"from": "2026-11-01", "to": "2026-11-30"}),
        (person.path, {"participant": person.mark}),
        ("/v1/studies/pilot/changes", {}),
        ("/v1/studies/pilot/webhooks", {}),
        ("/v1/foods/apple", {}),
    ):
        answer = client.get(path, headers=headers, params=params)
        assert answer.status_code == 200, (path, answer.text)
        told[path] = as_before(answer.json(), jump)
    lines = list(csv.DictReader(client.get("/v1/records", headers=headers, params={"format": "csv"}).text.splitlines()))
    assert len(lines) == 2
    told["csv"] = [line | {"change_seq": str(int(line["change_seq"]) - jump)} for line in lines]
    told["phone"] = client.get(person.path, headers=person.phone.headers).json()
    return told


def as_before(document, jump):
    if isinstance(document, list):
        return [as_before(one, jump) for one in document]
    if isinstance(document, dict):
        told = {key: as_before(value, jump) for key, value in document.items() if key != "next"}
        return told | {key: value - jump for key, value in told.items() if key == "change_seq"}
    return document


@pytest.mark.parametrize("onto_other", [False, True], ids=["same", "other"])
def test_restored_deployment_has_every_row_every_byte_and_every_answer(
    request, onto_other, person, source, admin, client, empty_machine, tmp_path
):
    """From SQLite and files onto SQLite and S3, and onto PostgreSQL and files."""
    before = answers(client, admin, person)
    store = {} if onto_other else s3_settings(request.getfixturevalue("s3_server"))
    machine = empty_machine("postgres" if onto_other else "sqlite", **store)
    done = source.back_up(tmp_path / "one.tar")
    assert (done.damaged_blobs, done.erased) == (0, [])
    machine.restore(tmp_path / "one.tar")
    assert without_note(machine.rows()) == later(source.rows())
    assert machine.stored() == {key: source.blobs.read(key) for key in named_blobs(source.database)}
    assert len(machine.stored()) >= 4
    with machine.served() as restored:
        for path, told in answers(restored, admin, person, CHANGE_SEQ_JUMP).items():
            assert told == before[path]
        assert restored.post("/v1/studies", headers=admin, json={"code": "next", "name": "Next"}).status_code == 201


EXTREMES = {  # column -> what SQLite and PostgreSQL both hold, and what a careless format loses
    "meal.details": ['{"n": 12345678901234567890123, "b": [1.5, null, "\\u00e4"]}', "null", "7"],
    "meal.local_date": ["0001-01-01", "9999-12-31"],
    "meal.captured_at": ["0001-01-01 00:00:00.000000", "9999-12-31 23:59:59.999999"],
    "meal.utc_offset_minutes": [-(2**31), 2**31 - 1],
    "meal_image.bytes": [2**63 - 1, -(2**63)],
    "effective_record.consumed_g": [5e-324, 0.1 + 0.2, math.inf],
    "participant.code": ["a\tb\nc\\'\";--\u2028😀", "NaN", "12"],
}
EARLIER_REFERS_TO_LATER = "UPDATE item SET parent_id = (SELECT id FROM item ORDER BY rowid DESC LIMIT 1)"
STRUCTURE = {  # all that a restore drops and creates again
    "sqlite": "SELECT name, sql FROM sqlite_master WHERE type IN ('index', 'trigger')",
    "postgresql": """
        SELECT indexname, split_part(indexdef, ' WHERE ', 1) FROM pg_indexes WHERE schemaname = current_schema()
        UNION ALL SELECT conname, pg_get_constraintdef(oid) FROM pg_constraint
            WHERE connamespace = current_schema()::regnamespace
        UNION ALL SELECT tgname, pg_get_triggerdef(oid) FROM pg_trigger WHERE NOT tgisinternal
    """,
}


def test_every_value_and_its_type_is_the_same_after_postgresql(person, source, empty_machine, tmp_path):
    """SQLite holds what it is given: a number as a text, or NULL as JSON's null, would come back as others."""
    for turn in range(3):
        with source.database.write() as session:
            session.execute(sa.text(EARLIER_REFERS_TO_LATER))
            for name, values in EXTREMES.items():
                table, column = name.split(".")
                update = sa.text(f"UPDATE {table} SET {column} = :value")
                session.execute(update, {"value": values[turn % len(values)]})
        between, after = empty_machine("postgres"), empty_machine("sqlite")
        source.back_up(tmp_path / f"{turn}-sqlite.tar")
        between.restore(tmp_path / f"{turn}-sqlite.tar")
        between.back_up(tmp_path / f"{turn}-postgres.tar")
        after.restore(tmp_path / f"{turn}-postgres.tar")
        before, again = raw_rows(source.database), raw_rows(after.database)
        assert before.keys() == again.keys()
        for name in before:
            assert again[name] == before[name], name
    for restored in (between, after):
        new = empty_machine("sqlite" if restored.database.is_sqlite else "postgres")
        upgrade(new.database)
        assert structure(restored.database) == structure(new.database)


def structure(database):
    """Every index, constraint and trigger by name, as the database itself writes it."""
    with database.read() as session:
        return dict(map(tuple, session.execute(sa.text(STRUCTURE[session.get_bind().dialect.name]))))


def raw_rows(database):
    """Table and column -> each row's value and SQLite's type of it, by the row's key.

    JSON is compared as a value, since PostgreSQL has its own spaces; so are numbers of changes, which a restore raises.
    """
    found = {}
    with database.read() as session:
        for table in tables_at(head_revision()).values():
            if table.name in ("audit_event", "job"):  # a restore writes there
                continue
            key = " || ' ' || ".join(column.name for column in table.primary_key)
            for column in table.columns:
                query = sa.text(f"SELECT {key}, {column.name}, typeof({column.name}) FROM {table.name} ORDER BY 1")
                rows = [tuple(row) for row in session.execute(query)]
                if isinstance(column.type, sa.types.NullType):
                    rows = [(key, json.loads(value) if kind == "text" else value, kind) for key, value, kind in rows]
                if column.name == "change_seq":
                    rows = [(key, value and value % CHANGE_SEQ_JUMP, kind) for key, value, kind in rows]
                found[table.name, column.name] = rows
    return found


def test_value_of_another_type_than_its_column_is_told_when_the_backup_is_made(person, source, tmp_path):
    for value in ("1.5", "'x'", "x'00'"):
        with source.database.write() as session:
            session.execute(sa.text(f"UPDATE meal SET utc_offset_minutes = {value}"))
        with pytest.raises(InvalidInputError, match="utc_offset_minutes") as refused:
            source.back_up(tmp_path / "one.tar")
        assert refused.value.code == "database_inconsistent"


def test_tables_and_their_columns_are_those_of_the_models():
    """Read from a scratch database they are complete, and each column is of the kind that its model says."""
    arrow_types = {
        sa.Uuid: pa.uuid(), UtcDateTime: pa.timestamp("us", "UTC"), sa.Date: pa.date32(), sa.JSON: pa.json_(),
        sa.LargeBinary: pa.binary(), sa.Float: pa.float64(), sa.Boolean: pa.bool_(), sa.Integer: pa.int64(),
        sa.String: pa.string(),
    }  # fmt: skip
    modelled = {
        table.name: {
            column.name: next(arrow for kind, arrow in arrow_types.items() if isinstance(column.type, kind))
            for column in table.columns
        }
        for table in Base.metadata.sorted_tables
        if table.name not in TRANSIENT_TABLES
    }
    schemas = {table.name: schema_of(table) for table in tables_at(head_revision()).values()}
    assert {name: dict(zip(schema.names, schema.types, strict=True)) for name, schema in schemas.items()} == modelled


def send_meal(state, phone, seed):
    metadata = meal_metadata(hints=[{"point": [30, 20], "food": "apple"}])
    assert phone.post(pair(seed), metadata).status_code == 202
    estimate(state, metadata["id"])
    return metadata["id"]


def test_restore_repeats_all_changes_to_who_pulled_later_ones_and_queues_waiting_meals_again(
    kind, state, phone, source, admin, client, empty_machine, tmp_path
):
    """Else figures that a restore took back would stay in a researcher's copy."""
    send_meal(state, phone, 1)
    waiting = [phone.post(pair(seed)).json()["id"] for seed in (2, 3)]
    with state.database.write() as session:
        meal = session.scalars(sa.select(Meal).where(Meal.client_id == uuid.UUID(waiting[0]))).one()
        meal.status = session.scalars(sa.select(Job).where(Job.meal_id == meal.id)).one().state = "processing"
    source.back_up(tmp_path / "one.tar")
    held = client.get("/v1/studies/pilot/changes", headers=admin).json()["records"]
    send_meal(state, phone, 4)
    pulled = client.get("/v1/studies/pilot/changes", headers=admin).json()
    assert len(pulled["records"]) == len(held) + 1
    machine = empty_machine(kind)
    assert machine.restore(tmp_path / "one.tar").queued_again == 2
    with machine.served() as restored:
        again = restored.get(pulled["next"], headers=admin).json()["records"]
    assert [row["id"] for row in again] == [row["id"] for row in held]
    assert again[0]["change_seq"] > pulled["records"][-1]["change_seq"]
    assert sorted(row["state"] for row in machine.rows()["job"].values()) == ["done", "queued", "queued"]
    with machine.database.write() as session:
        assert len(jobs.claim_jobs(session, "somebody", protocol=1, room=9)) == 2


def test_meals_that_come_during_a_backup_are_in_it_wholly_or_not_at_all(
    kind, state, source, enrol, empty_machine, tmp_path
):
    phones = [enrol(f"P{number}") for number in range(2)]
    sent, stop, waits = [], threading.Event(), iter(range(8))

    def send(phone, seed):
        while not stop.is_set():
            sent.append(send_meal(state, phone, seed))
            seed += 1

    def wait_for_another(_words):
        """The first steps of the backup each let a meal come in between."""
        count = len(sent)
        if next(waits, None) is not None:
            wait_until(lambda: len(sent) > count, "another meal")

    threads = [threading.Thread(target=send, args=(phone, 1000 * n)) for n, phone in enumerate(phones)]
    for thread in threads:
        thread.start()
    try:
        wait_for_another("before")
        least = len(sent)
        with (tmp_path / "busy.tar").open("wb") as file:
            done = write_backup(source.database, source.blobs, source.box, file, wait_for_another)
        most = len(sent)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert (done.damaged_blobs, done.erased) == (0, [])
    machine = empty_machine(kind)
    machine.restore(tmp_path / "busy.tar")
    rows = machine.rows()
    assert least <= len(rows["meal"]) < most  # it is of one moment, and others came after it
    assert len(rows["meal_image"]) == 2 * len(rows["meal"])
    assert machine.stored().keys() == named_blobs(machine.database)
    assert rows["study"].keys() == source.rows()["study"].keys()
    assert rebuild_records(machine.database, write=False).different == 0


def test_erasures_after_the_backup_are_done_again_before_anybody_is_served(
    kind, state, source, enrol, client, settings, blob_settings, empty_machine, tmp_path
):
    gone, stays = Person(state, enrol, "nobodys-words-4Xz", seed=1), Person(state, enrol, "somebody-7Kq", seed=2)
    store_what_is_named(source.database, source.blobs)
    erased_meal = send_meal(state, stays.phone, 9)
    source.back_up(tmp_path / "one.tar")
    assert client.post("/v1/me/withdrawal", headers=gone.phone.headers).status_code == 200
    assert client.delete(f"/v1/meals/{erased_meal}", headers=stays.phone.headers).status_code == 200
    ledger = blob_settings | {"blob_url": None, "erasure_url": settings.resolved_erasure_url}
    machine = empty_machine(kind, **ledger)
    machine.restore(tmp_path / "one.tar")
    codes = {row["code"] for row in machine.rows()["participant"].values()}
    assert codes == {stays.mark}
    assert {row["client_id"] for row in machine.rows()["meal"].values()} == {uuid.UUID(stays.metadata["id"])}
    assert machine.stored().keys() == named_blobs(machine.database)
    assert len(machine.stored()) == len(named_blobs(source.database)) > 3


def test_erasures_of_after_the_backup_under_a_lost_key_are_refused_before_anything_is_written(
    kind, state, phone, source, client, settings, blob_settings, empty_machine, tmp_path
):
    """Nobody can tell whom they erased; found out later, the restored deployment would not start any more."""
    stays, erased = send_meal(state, phone, 9), send_meal(state, phone, 10)
    source.back_up(tmp_path / "one.tar")
    assert client.delete(f"/v1/meals/{erased}", headers=phone.headers).status_code == 200
    ledger = blob_settings | {"blob_url": None, "erasure_url": settings.resolved_erasure_url}
    machine = empty_machine(kind, **ledger, secret_key="x" * 40)
    with pytest.raises(SecretKeyError, match="erasures from after the backup"):
        machine.restore(tmp_path / "one.tar", other_key=True)
    assert (current_revision(machine.database), machine.stored()) == (None, {})
    machine = empty_machine(kind, **ledger | {"erasure_url": f"file://{tmp_path / 'new-ledger'}"}, secret_key="x" * 40)
    machine.restore(tmp_path / "one.tar", other_key=True)
    assert {row["client_id"] for row in machine.rows()["meal"].values()} == {uuid.UUID(stays), uuid.UUID(erased)}


def test_restore_that_was_broken_off_can_be_done_again(kind, person, source, empty_machine, monkeypatch, tmp_path):
    source.back_up(tmp_path / "one.tar")
    machine = empty_machine(kind)
    stored, put_file = [], machine.blobs.put_file

    def put_one_and_break(key, path):
        if stored:
            raise OSError("the network is gone")
        stored.append(key)
        put_file(key, path)

    with monkeypatch.context() as patch:
        patch.setattr(machine.blobs, "put_file", put_one_and_break)
        with pytest.raises(OSError, match="network"):
            machine.restore(tmp_path / "one.tar")
    assert machine.stored().keys() == set(stored)

    def break_off(*_arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(restore_module, "_mark_erased", break_off)  # the rows are there, and not committed
        with pytest.raises(KeyboardInterrupt):
            machine.restore(tmp_path / "one.tar")
    assert machine.rows()["meal"] == {}
    machine.restore(tmp_path / "one.tar")
    assert without_note(machine.rows()) == later(source.rows())
    assert machine.stored().keys() == named_blobs(source.database)


def test_restore_asks_for_room_for_what_is_not_there_yet(kind, person, source, empty_machine, monkeypatch, tmp_path):
    """The disk may be just large enough, and the restore was broken off and is done again."""
    done = source.back_up(tmp_path / "one.tar")
    machine = empty_machine(kind)
    monkeypatch.setattr(machine.blobs, "free_bytes", lambda: done.blob_bytes - 1)
    with pytest.raises(StorageFullError):
        machine.restore(tmp_path / "one.tar")
    assert machine.stored() == {}
    there = min(named_blobs(source.database))
    machine.blobs.put_bytes(there, source.blobs.read(there))
    machine.restore(tmp_path / "one.tar")
    assert machine.stored().keys() == named_blobs(source.database)


@pytest.mark.both_stores
def test_restore_into_a_bucket_does_not_ask_for_room_on_this_machine(
    kind, person, source, s3_server, empty_machine, monkeypatch, tmp_path
):
    done = source.back_up(tmp_path / "one.tar")
    machine = empty_machine(kind, **s3_settings(s3_server))
    monkeypatch.setattr(machine.blobs, "free_bytes", lambda: done.blob_bytes // 2)
    machine.restore(tmp_path / "one.tar")
    assert machine.stored().keys() == named_blobs(source.database)


def test_backup_of_an_older_schema_is_restored_and_brought_up_to_date(
    kind, person, source, empty_machine, next_migration, tmp_path
):
    older = head_revision()
    assert source.back_up(tmp_path / "old.tar").manifest.revision == older
    assert next_migration() != older
    upgrade(source.database)
    machine = empty_machine(kind)
    machine.restore(tmp_path / "old.tar")
    assert current_revision(machine.database) == head_revision()
    assert without_note(machine.rows()) == later(source.rows())


@pytest.mark.both_stores
def test_blob_that_an_erasure_takes_meanwhile_is_no_fault(kind, person, state, enrol, source, empty_machine, tmp_path):
    """Retention takes pictures without the ledger: the restored rows say that they are gone."""
    with state.database.write() as session:
        session.execute(sa.text("UPDATE study SET retention_days = 1"))

    def erase(words):
        if words.startswith("item_measure"):  # the rows that name the blobs have been read
            assert erase_old_pictures(state.database, datetime.now(UTC) + timedelta(days=2)) == 1
            assert BlobDeleter(state.database, state.blobs).delete_scheduled() == 3

    with (tmp_path / "one.tar").open("wb") as file:
        done = write_backup(source.database, source.blobs, source.box, file, erase)
    assert (len(done.erased), done.damaged_blobs) == (3, 0)
    machine = empty_machine(kind)
    machine.restore(tmp_path / "one.tar")
    with machine.database.read() as session:
        assert all(session.scalars(sa.select(MealImage.erased_at)))
        assert session.scalars(sa.select(RunArtefact)).all() == []
    assert machine.stored().keys() == named_blobs(machine.database)


def test_damaged_and_missing_blobs_are_told_by_name_and_all_others_but_orphans_are_in_the_backup(
    kind, person, source, empty_machine, tmp_path
):
    damaged, missing, *whole = sorted(named_blobs(source.database))
    assert source.stored().keys() >= {damaged, missing, *whole}
    source.blobs.put_bytes(damaged, b"other bytes")
    source.blobs.delete(missing)
    source.blobs.put_bytes("study/meal/left/" + "0" * 64, b"of nobody")  # an orphan, as an upload leaves it
    done = source.back_up(tmp_path / "one.tar")
    assert done.damaged == {damaged: "its bytes are not those that were stored", missing: "missing"}
    assert done.blobs == len(whole)
    machine = empty_machine(kind)
    checked = machine.restore(tmp_path / "one.tar").checked
    assert (checked.damaged_blobs, checked.damaged) == (2, done.damaged)
    assert machine.stored().keys() == set(whole)


@pytest.mark.parametrize("kind", ["postgres"])
def test_blob_that_a_bucket_s_disk_altered_is_told_by_name(kind, person, source, tmp_path):
    """Its metadata still tell the right digest, and a bucket gives an error of its own."""
    altered, *whole = sorted(named_blobs(source.database))
    obstore.put(source.blobs._store, altered, b"other bytes", attributes={"sha256": altered[-64:]})
    done = source.back_up(tmp_path / "one.tar")
    assert done.damaged == {altered: "its bytes are not those that were stored"}
    assert done.blobs == len(whole)


def test_backup_that_breaks_off_leaves_no_file_and_calls_no_blob_damaged(kind, person, source, monkeypatch, tmp_path):
    """Else a key that expires, or an hour without the store, would give a backup without photographs that counts."""
    folder = tmp_path / "backups"
    folder.mkdir()
    for fault in (StoreRefusesError(errno.EIO, "our key"), OSError(errno.EIO, "answers with an error")):

        def fail(*_arguments, fault=fault):
            raise fault

        with monkeypatch.context() as patch:
            patch.setattr(source.blobs, "stream", fail)
            patch.setattr(source.blobs, "keys", fail)
            with pytest.raises(OSError, match=fault.strerror):
                source.back_up(folder / "one.tar")

    def break_off(words):
        raise KeyboardInterrupt(words)

    with pytest.raises(KeyboardInterrupt):
        source.back_up(folder / "one.tar", break_off)
    assert list(folder.iterdir()) == []
    with source.database.read() as session:
        assert last_backup(session) is None


def test_blob_that_alone_cannot_be_read_is_told_and_a_fault_that_passes_is_not(
    kind, person, source, monkeypatch, tmp_path
):
    bad, once, *whole = sorted(named_blobs(source.database))
    stream, failed = source.blobs.stream, []

    def stream_or_fail(key, *sizes):
        if key == bad or (key == once and once not in failed):
            failed.append(key)
            raise OSError(errno.EIO, "input/output error")
        return stream(key, *sizes)

    monkeypatch.setattr(source.blobs, "stream", stream_or_fail)
    done = source.back_up(tmp_path / "one.tar")
    assert done.damaged == {bad: "the store cannot read it"}
    assert done.blobs == len(whole) + 1
