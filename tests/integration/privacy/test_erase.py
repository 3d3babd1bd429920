"""Crashes between the steps of an erasure, blobs that must not go, and those that nobody names."""

import json
import pathlib
import uuid
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
import sqlalchemy as sa

from app.children.faults import PHOTOGRAPH_ERASED, JobFailure
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.operations.chores import worker_chores
from app.people import privacy_queries as people_privacy
from app.people.access.secret_box import SecretBox
from app.people.models import Participant, Study
from app.people.privacy_models import BlobDeletion, ErasureReceipt
from app.people.tombstones import digest_of
from app.privacy import queries as privacy
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import ErasureLedger
from app.privacy.reapply_erasures import reapply_erasures
from app.privacy.retention import erase_old_pictures
from app.storage.blob_store import BlobMissingError
from app.storage.opening import open_blob_store
from tests.integration.conftest import meal_metadata
from tests.integration.people.persons import kept_person
from tests.support import estimates
from tests.support.photographs import pair
from tests.support.stores import make_old, store_bytes, stored_names


@pytest.fixture
def person(state, enrol, client, admin):
    return kept_person(state, enrol, client, admin, "somebody-2Wd", seed=1)


def test_erasure_that_died_before_its_transaction_is_finished_once_by_the_next_start_unless_it_is_recent(
    person, state, client
):
    eraser = state.part(Eraser)
    erasure = eraser.intend("participant", "erase", person.participant_id)
    without_rows = eraser.intend("participant", "erase", uuid.uuid4())
    assert reapply_erasures(eraser, state.blobs, before=datetime.now(UTC) - timedelta(minutes=10)) == 0
    assert person.phone.get(person.path).status_code == 200  # a recent one is left to its process
    assert reapply_erasures(eraser, state.blobs) == 1
    assert person.phone.get(person.path).json()["code"] == "withdrawn"
    assert client.get(f"/v1/receipts/{erasure.receipt_id}").json()["counts"]["meal"] == 1
    assert reapply_erasures(eraser, state.blobs) == 0
    with state.database.read() as session:
        found = people_privacy.tombstones_among(session, "participant", [without_rows.digest])
    assert found == {without_rows.digest}


def test_two_policies_of_a_person_stand_in_the_ledger_without_an_id_and_are_both_applied(person, state, settings):
    for deed in ("erase", "keep"):
        state.part(Eraser).intend("participant", deed, person.participant_id)
    ledger = open_blob_store(settings.resolved_erasure_url, settings)
    held = store_bytes(ledger)
    for thing in (person.participant_id, person.meal_id):
        assert str(thing).encode() not in held
        assert thing.hex.encode() not in held
    entries = [json.loads(ledger.read(blob.key)) for blob in ledger.keys("participant/")]
    assert [set(entry) for entry in entries] == [{"deed", "receipt", "at", "key"}] * 2
    assert reapply_erasures(state.part(Eraser), state.blobs) == 2
    with state.database.read() as session:
        assert session.get(Participant, person.participant_id) is None
    box, one = state.part(SecretBox), uuid.uuid4()
    digests = {digest_of(box, "participant", deed, one) for deed in ("keep", "anonymise", "erase")}
    assert len(digests | {digest_of(box, "meal", "erase", one)}) == 4


def test_erasure_that_is_asked_for_again_keeps_its_receipt_and_is_done_once(person, state):
    """The first died before its transaction."""
    eraser = state.part(Eraser)
    first = eraser.intend("meal", "erase", person.meal_id)
    answer = person.phone.client.delete(person.path, headers=person.phone.headers)
    assert answer.json()["id"] == str(first.receipt_id)
    assert eraser.carry_out_on_meal(first, person.meal_id, None) is None
    with state.database.read() as session:
        receipt = session.scalars(sa.select(ErasureReceipt)).one()
    assert eraser.ledger.read("meal", first.digest).receipt_id == receipt.id  # what a restore would bring back


@pytest.mark.both_stores
def test_concurrent_erasures_of_a_meal_give_one_receipt(person, state, monkeypatch):
    """Each looked into the ledger before the other had written; the one who wrote first is the one who erases."""

    def not_there_yet(_, kind, digest):
        raise BlobMissingError(f"{kind}/{digest}")

    with monkeypatch.context() as patch:
        patch.setattr(ErasureLedger, "read", not_there_yet)
        first, second = (state.part(Eraser).intend("meal", "erase", person.meal_id) for _ in "ab")
    receipt = state.part(Eraser).carry_out_on_meal(first, person.meal_id, None)
    assert state.part(Eraser).carry_out_on_meal(second, person.meal_id, None) is None
    assert receipt.id == second.receipt_id
    assert state.part(Eraser).ledger.read("meal", first.digest).receipt_id == receipt.id
    other = state.part(Eraser).intend("meal", "erase", uuid.uuid4())
    assert other.receipt_id != receipt.id


def test_blob_that_a_row_names_is_not_deleted_by_a_scheduled_deletion(person, state):
    with state.database.write() as session:
        keys = list(session.scalars(sa.select(MealImage.blob_key)))
        study_id = session.scalars(sa.select(Study.id)).one()
        wanted = [*keys, f"{study_id}/{person.meal_id}/"]
        people_privacy.schedule_deletion(session, wanted, datetime.now(UTC))
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert all(state.blobs.has(key) for key in keys)
    with state.database.read() as session:
        assert session.scalars(sa.select(BlobDeletion)).all() == []


def test_orphans_go_past_the_grace_time_and_what_is_named_young_awaited_or_of_another_database_stays(person, state):
    named = {blob.key for blob in state.blobs.keys()}  # noqa: SIM118  # a store is no mapping
    study_id = next(iter(named)).split("/")[0]
    old, young = (f"{study_id}/{uuid.uuid4()}/left/{n * 64}" for n in "ab")
    foreign = f"{uuid.uuid4()}/{uuid.uuid4()}/left/{'a' * 64}"  # of no study that the database knows
    of_a_job = seal_stray(state, f"runs/{uuid.uuid4()}/topview.jpg")
    for key in (old, young, foreign):
        state.blobs.put_bytes(key, b"photograph of an upload that failed")
    with state.database.write() as session:
        session.execute(sa.update(Job).values(state="queued", finished_at=None))
    make_old(state.blobs, named | {old, foreign, of_a_job})
    deleter = BlobDeleter(state.database, state.blobs)
    assert sum(deleter.orphan_batches(timedelta(days=3))) == 0
    assert deleter.delete_orphans() == 1
    left = {blob.key for blob in state.blobs.keys()}  # noqa: SIM118
    assert left == named | {young, foreign, of_a_job}


@pytest.mark.parametrize("how", ["retention", "anonymise"])
def test_photographs_that_lost_or_that_a_restored_store_brings_back_go_though_their_meal_stays(
    how, person, state, client
):
    saved = {blob.key: state.blobs.read(blob.key) for blob in state.blobs.keys()}  # noqa: SIM118
    stray = seal_stray(state, "left")
    with state.database.write() as session:
        session.execute(sa.update(Study).values(retention_days=1, withdrawal_policy="anonymise"))
    if how == "retention":
        erase_old_pictures(state.database, datetime.now(UTC) + timedelta(days=2))
    else:
        client.post("/v1/me/withdrawal", headers=person.phone.headers)
    deleter = BlobDeleter(state.database, state.blobs)
    deleter.delete_scheduled()
    make_old(state.blobs)
    assert deleter.delete_orphans() == 1
    assert not state.blobs.has(stray)
    for key, content in saved.items():
        state.blobs.put_bytes(key, content)
    make_old(state.blobs)
    deleter.delete_orphans()
    assert {key.split("/")[-2] for key in saved} > {"result.json"}
    assert {blob.key.split("/")[-2] for blob in state.blobs.keys()} == {"result.json"}  # noqa: SIM118


def test_photograph_that_is_sent_again_while_orphans_are_looked_for_stays(person, state, settings, monkeypatch):
    stray = seal_stray(state, "left")
    make_old(state.blobs)
    look = privacy.needed_keys

    def look_then_sent_again(session, keys):
        found = look(session, keys)
        state.blobs.put_bytes(stray, b"sent again")
        return found

    monkeypatch.setattr(privacy, "needed_keys", look_then_sent_again)
    assert BlobDeleter(state.database, state.blobs).delete_orphans() == 0
    assert state.blobs.read(stray) == b"sent again"


def seal_stray(state, slot):
    """Seal a blob of the person's meal that no row names; its key."""
    with state.database.read() as session:
        study_id, meal_id = session.execute(sa.select(Meal.study_id, Meal.id)).one()
    key = f"{study_id}/{meal_id}/{slot}/{'a' * 64}"
    state.blobs.put_bytes(key, b"sealed, and never written down")
    return key


class ErasingChildren:
    """A child pool of which the meal is erased while it computes."""

    def __init__(self, erase):
        self._erase = erase

    def run(self, request, on_stage, *, name="", is_alone=False):
        (pathlib.Path(request.arguments["output_dir"]) / "topview.jpg").write_bytes(b"a derived picture")
        self._erase()
        artefact = {"name": "topview.jpg", "media_type": "image/jpeg", "bytes": 17, "sha256": "c" * 64}
        return SimpleNamespace(failure=None, result=estimates.answer(artefacts=[artefact]))


@pytest.mark.parametrize("what", ["meal", "participant", "photographs"])
def test_pictures_sealed_after_the_erasure_are_deleted_too(what, phone, state, settings, client):
    body = meal_metadata()
    phone.post(pair(), body)
    with state.database.read() as session:
        job_id = session.scalars(sa.select(Job.id)).one()

    def erase():
        if what == "meal":
            client.delete(f"/v1/meals/{body['id']}", headers=phone.headers)
        elif what == "participant":
            client.post("/v1/me/withdrawal", headers=phone.headers)
        else:
            with state.database.write() as session:
                found = privacy.ids_in(list(session.scalars(sa.select(Meal.id))))
                people_privacy.schedule_deletion(
                    session, privacy.mark_images_erased(session, found, datetime.now(UTC)), datetime.now(UTC)
                )
        BlobDeleter(state.database, state.blobs).delete_scheduled()

    work = EstimatePair(state.database, state.blobs, ErasingChildren(erase), settings)
    with pytest.raises(JobFailure) as caught:
        work.compute(job_id)
    assert caught.value.failure == PHOTOGRAPH_ERASED
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert list(state.blobs.keys()) == []
    assert stored_names(state.blobs) == []


@pytest.mark.both_stores
def test_upload_that_is_sealed_while_its_person_leaves_is_refused_and_deleted(phone, state, client, monkeypatch):
    put = state.blobs.put_files

    def put_and_leave(files):
        put(files)
        client.post("/v1/me/withdrawal", headers=phone.headers)

    monkeypatch.setattr(state.blobs, "put_files", put_and_leave)
    answer = phone.post(pair())
    assert (answer.status_code, answer.json()["code"]) == (410, "withdrawn")
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert list(state.blobs.keys()) == []


def test_worker_does_the_chores_of_privacy(person, state, settings, client):
    with state.database.write() as session:
        session.execute(sa.update(Study).values(retention_days=1))
        session.execute(sa.update(Meal).values(received_at=datetime.now(UTC) - timedelta(days=2)))
    made = worker_chores(state.database, state.blobs, state.part(SecretBox), settings)
    chores = {chore.name: chore for chore in made}
    assert chores["erase_old_pictures"].run() == 1
    client.delete(person.path, headers=person.phone.headers)
    for name in ("delete_blobs", "finish_erasures", "delete_orphans"):
        chores[name].run()
    assert list(state.blobs.keys()) == []
