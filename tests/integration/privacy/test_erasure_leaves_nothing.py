"""After an erasure nothing of the person is anywhere: no row, no byte of the database, no file; the others' stay."""

import contextlib
import sqlite3

import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient
from pydantic import SecretStr

from app.core.settings import Settings
from app.db.base import Base
from app.main import create_app
from app.people.access.last_use import LastUse
from app.people.access.secret_box import SecretKeyError
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.erase import Eraser
from app.privacy.reapply_erasures import reapply_erasures
from app.records.recompute_records import Rebuilt, rebuild_records
from app.storage.opening import open_blob_store
from tests.integration.people.persons import (
    FILE_TABLES,
    OWNERS,
    Person,
    all_keys,
    database_bytes,
    make_files,
    personal_tables,
    tables_with_alias,
)
from tests.support.stores import copy_of_store, store_bytes

STAYS_WITHOUT_MEAL = {
    "access_token",
    "camera_calibration",
    "day_event",
    "device",
    "diary_day",
    "enrolment",
    "participant",
    "push_subscription",
    "reference_day",
    "webhook_delivery",
}


@pytest.fixture
def bystander(state, enrol):
    return Person(state, enrol, "somebody-else-7Kq", seed=5, with_files=True)


@pytest.fixture
def subject(state, enrol, bystander):
    return Person(state, enrol, "nobodys-words-4Xz", seed=1, with_files=True)


def settle(state):
    state.part(LastUse).settle()
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert state.database.empty_log()


def assert_nothing_is_left_once_files_are_made(state, needles):
    assert make_files(state) == ["done", "done"]  # both releases without what was erased
    settle(state)
    assert_nothing_is_in("database", database_bytes(state.database), needles)
    assert_nothing_is_in("store", store_bytes(state.blobs), needles)


def assert_nothing_is_in(where, held, needles):
    for needle in needles:
        at = held.find(needle)
        assert at < 0, f"{needle!r} is left in the {where}: ...{held[max(0, at - 200) : at + 100]!r}..."


def test_every_reference_to_rows_that_are_erased_has_an_index():
    """Without one each erased row makes the database read the whole table that refers to it."""
    missing = set()
    for name in personal_tables():
        table = Base.metadata.tables[name]
        first = {next(iter(index.columns)).name for index in table.indexes} | {next(iter(table.primary_key)).name}
        first |= {next(iter(each.columns)).name for each in table.constraints if isinstance(each, sa.UniqueConstraint)}
        for key in table.foreign_keys:
            if key.column.table.name in OWNERS and key.parent.name not in first:
                missing.add((name, key.parent.name))
    assert missing == set()


@pytest.mark.parametrize("what", ["participant", "meal"])
def test_erased_person_or_meal_leaves_nothing_and_goes_again_from_a_restored_backup_before_anything_is_served(
    what, state, settings, subject, bystander, client, tmp_path
):
    """A table that a later version adds must be filled in tests/integration/people/persons.py, and then be erased."""
    assert {table for table in personal_tables() | FILE_TABLES if not subject.rows[table]} == set()
    needles, of_the_person = subject.needles(), keys_of_person_alone(state, subject)
    assert sum(needle in database_bytes(state.database) for needle in needles) > 20
    assert sum(needle in store_bytes(state.blobs) for needle in needles) > 5
    for folder in ("/exports/", "/releases/"):
        assert subject.mark.lower().encode() in files_below(state, folder)
    if what == "meal":
        needles = [needle for needle in needles if needle not in of_the_person]
    url = backup(state.database, tmp_path)
    blob_url = copy_of_store(state.blobs, settings, tmp_path / "restored" / "blobs")
    if what == "meal":
        answer = client.delete(subject.path, headers=subject.phone.headers)
    else:
        answer = client.post("/v1/me/withdrawal", headers=subject.phone.headers)
    assert answer.status_code == 200, answer.text
    settle(state)
    assert_nothing_is_in("database", database_bytes(state.database), needles)  # while the releases still have them
    assert_nothing_is_left_once_files_are_made(state, needles)
    left = all_keys(state.database)
    stays = {table for table in personal_tables() if set(subject.rows[table]) & left[table]}
    assert stays == (STAYS_WITHOUT_MEAL if what == "meal" else set())
    if what == "participant":
        assert tables_with_alias(state.database, subject.aliases) <= {"audit_event"}
    assert_bystander_is_untouched(state, bystander)
    restored = other_settings(
        settings,
        {
            "database_url": url,
            "blob_url": blob_url,
            "erasure_url": settings.resolved_erasure_url,
            "data_dir": tmp_path / "restored",
        },
    )
    assert sum(needle in store_bytes(open_blob_store(blob_url, restored)) for needle in needles) > 3
    other_key = other_settings(restored, {"secret_key": SecretStr("another key, which made no digest at all")})
    with pytest.raises(SecretKeyError, match="ledger"), TestClient(create_app(other_key)):
        pass
    with TestClient(create_app(restored)) as again:
        state = again.app.state.api
        assert state.database.url != client.app.state.api.database.url
        assert_nothing_is_left_once_files_are_made(state, needles)
        assert again.get(f"/v1/receipts/{answer.json()['id']}").json() == answer.json()
        call = again.get(subject.path, headers=subject.phone.headers)
        assert call.json()["code"] == ("meal_deleted" if what == "meal" else "withdrawn")
        assert again.get(bystander.path, headers=bystander.phone.headers).status_code == 200
        assert reapply_erasures(state.part(Eraser), state.blobs) == 0


def other_settings(settings, changes):
    return Settings(**(settings.model_dump() | changes))  # a copy would keep what is resolved already


def backup(database, folder):
    """Copy the database as it is now; returns the URL of the copy."""
    path = folder / "restored" / "tada.sqlite3"
    path.parent.mkdir(exist_ok=True)
    with (
        contextlib.closing(sqlite3.connect(sa.make_url(database.url).database)) as source,
        contextlib.closing(sqlite3.connect(path)) as target,
    ):
        source.backup(target)
    return f"sqlite:///{path}"


def keys_of_person_alone(state, person):
    """Needles that belong to the person and not to the meal."""
    stay = {person.mark.encode(), person.token_sha256.encode()}
    with state.database.read() as session:
        for name in STAYS_WITHOUT_MEAL:
            table = Base.metadata.tables[name]
            for row in session.execute(sa.select(table)):
                stay.update(str(value).lower().encode() for value in row)
                stay.update(str(value).replace("-", "").lower().encode() for value in row)
    return stay - {str(person.meal_id).encode(), person.meal_id.hex.encode()}


def assert_bystander_is_untouched(state, bystander):
    left = all_keys(state.database)
    assert {table: set(keys) - left[table] for table, keys in bystander.rows.items() if set(keys) - left[table]} == {}
    answer = bystander.phone.get(bystander.path)
    assert answer.status_code == 200
    assert all(state.blobs.has(key) for key in blob_keys(state))
    assert rebuild_records(state.database, write=False) == Rebuilt(compared=2, different=0)


def files_below(state, folder):
    keys = [blob.key for blob in state.blobs.keys() if folder in blob.key]  # noqa: SIM118  # a store is no mapping
    return b"".join(b"".join(state.blobs.stream(key)) for key in keys).lower()


def blob_keys(state):
    with state.database.read() as session:
        return [
            *session.scalars(sa.text("SELECT blob_key FROM meal_image")),
            *session.scalars(sa.text("SELECT blob_key FROM run_artefact")),
        ]
