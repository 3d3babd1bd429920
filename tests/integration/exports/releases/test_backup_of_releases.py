"""Backups contain whole releases but no exports; a later erasure reaches a restored release."""

import csv
import io
import uuid

import pytest
import sqlalchemy as sa

from app.exports.models import Export
from app.exports.release_models import Release, ReleaseFile
from app.exports.releases.file_runner import FileRunner
from app.foods.models import Food
from app.privacy.delete_blobs import BlobDeleter
from tests.conftest import postgres_database
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.operations.deployments import Deployment, deployment
from tests.integration.people.people import make_staff
from tests.support.stores import stored_names

pytestmark = pytest.mark.slow
LARGE = ("food_posting", "food_word_trigram", "food_nutrient", "food_code", "food_portion")
PATH = "/v1/studies/pilot/releases"


@pytest.fixture
def source(state, settings):
    """A deployment with a food table that is quick to copy."""
    with state.database.write() as session:
        apple = session.scalar(sa.select(Food.id).where(Food.key == "apple"))
        for table in LARGE:
            of_apple = "food_id = :apple" if table != "food_word_trigram" else "word LIKE 'apple%'"
            session.execute(sa.text(f"DELETE FROM {table} WHERE NOT ({of_apple})"), {"apple": apple})
    return Deployment(settings, state.database, state.blobs)


@pytest.fixture
def machine(request, tmp_path, source):
    """An empty one on PostgreSQL, that shares the ledger."""
    (tmp_path / "machine").mkdir()
    ledger = {"erasure_url": source.settings.resolved_erasure_url}
    with (
        postgres_database(request.getfixturevalue("postgres_server")) as url,
        deployment(tmp_path / "machine", url, **ledger) as made,
    ):
        yield made


@pytest.fixture
def frozen(client, admin, enrol, state, source):
    """A release and an export that are made, of two meals of two participants: a phone and its meal."""
    phones = {code: enrol(code) for code in ("P001", "P002")}
    meals = {code: add_meal(state, code, "2026-11-01", eaten_item(100.0, "apple")) for code in phones}
    owner = make_staff(client, admin, "olga", pilot="owner")
    owner.post(PATH, json={"name": "baseline"})
    owner.post("/v1/studies/pilot/exports", json={"rows": "items"})
    assert run(source).outcome == run(source).outcome == "done"
    return owner, phones["P001"], meals["P001"]


def run(made):
    return FileRunner(made.database, made.blobs, made.settings, made.box, uuid.uuid4()).run_one()


def participants(answer):
    assert answer.status_code == 200, answer.text
    return {row["participant"] for row in csv.DictReader(io.StringIO(answer.text, newline=""))}


def test_restored_release_is_whole_and_no_export_is_left_dangling(frozen, source, machine, tmp_path):
    owner, phone, meal = frozen
    source.back_up(tmp_path / "backup.tar")
    erased = phone.client.delete(f"/v1/meals/{meal}", headers=phone.headers)
    assert erased.status_code == 200
    machine.restore(tmp_path / "backup.tar")
    with machine.database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Export)) == 0
        assert session.scalars(sa.select(Release.state)).one() == "changing"  # the restore has erased again
    assert not [name for name in stored_names(machine.blobs) if "/exports/" in name]
    assert run(machine).outcome == "done"
    with machine.served() as client:
        found = client.get(f"{PATH}/baseline/files/items.csv", headers=owner.headers)
        assert participants(found) == {"P002"}
        assert client.get(f"{PATH}/baseline/check", headers=owner.headers).json()["is_whole"] is True


def test_release_rewritten_during_the_backup_is_reported_to_lack_files(frozen, source, machine, tmp_path):
    _, phone, meal = frozen

    def change_behind_the_rows(words):
        """Once its rows are read and no blob is: an erasure, the release anew, its old files deleted."""
        if words.startswith("release_file:") and phone is not None:
            phone.client.delete(f"/v1/meals/{meal}", headers=phone.headers)
            run(source)
            BlobDeleter(source.database, source.blobs).delete_scheduled()

    source.back_up(tmp_path / "backup.tar", change_behind_the_rows)
    machine.restore(tmp_path / "backup.tar")
    with machine.database.read() as session:
        release = session.scalars(sa.select(Release)).one()
        assert (release.state, release.failure_code) == ("failed", "release_files_missing")
        assert session.scalar(sa.select(sa.func.count()).select_from(ReleaseFile)) == 0
