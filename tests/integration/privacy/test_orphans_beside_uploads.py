"""A phone sends again what an earlier try sealed and never wrote down, just when that goes as an orphan.

Whoever comes first, a photograph that was acknowledged stays. Each test forces one order of the two.
"""

import contextlib
import threading

import pytest
import sqlalchemy as sa

from app.core.errors import UnavailableError
from app.db import spent_keys
from app.meals.stored import queries as meals
from app.meals.stored.job_models import Job
from app.meals.stored.models import MealImage
from app.meals.stored.record_models import Run
from app.meals.upload.after_meal import SubmitAfterPair
from app.meals.upload.submit_meal import SubmitMeal
from app.privacy import queries as privacy
from app.privacy.delete_blobs import BlobDeleter
from tests.integration.conftest import meal_metadata
from tests.integration.records.after_pairs import Table
from tests.support import estimates
from tests.support.photographs import pair
from tests.support.stores import make_old
from tests.support.waiting import PATIENCE_SECONDS, wait_for_blocked_transaction


class Sending:
    """A phone with a meal whose first try failed after its photographs were sealed, two days ago."""

    def __init__(self, phone, state, monkeypatch):
        self.phone, self.state, self.metadata, self.photos = phone, state, meal_metadata(), pair(3)
        Table(phone, state, seed=9)  # another meal, whose blobs are named
        named = keys_of(state)
        with monkeypatch.context() as patch:
            patch.setattr(SubmitMeal, "_write", out_of_order)
            assert self.send().status_code == 503
        self.orphans = keys_of(state) - named
        assert len(self.orphans) == 2
        make_old(state.blobs)

    def send(self):
        return self.phone.post(self.photos, self.metadata)

    def delete_orphans(self):
        return BlobDeleter(self.state.database, self.state.blobs).delete_orphans()

    def assert_kept(self):
        """What was acknowledged: both photographs, in the store, and nothing else once orphans are gone."""
        meal = self.phone.get(f"/v1/meals/{self.metadata['id']}").json()
        assert {slot: image["durable"] for slot, image in meal["images"].items()} == {"left": True, "right": True}
        with self.state.database.write() as session:
            session.execute(
                sa.update(Job).values(state="done", finished_at=Job.enqueued_at)
            )  # while one waits, all of its meal stays
        make_old(self.state.blobs)
        self.delete_orphans()
        with self.state.database.read() as session:
            assert set(session.scalars(sa.select(MealImage.blob_key))) == keys_of(self.state)


def keys_of(state):
    return {blob.key for blob in state.blobs.keys()}  # noqa: SIM118  # a store is no mapping


def out_of_order(*_, **__):
    raise UnavailableError("The database does not answer.")


def in_thread(work):
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


@contextlib.contextmanager
def deletion_on_its_way(state, monkeypatch, delete_orphans):
    """Within: a thread that has spent the orphans' keys, and deletes the first blob from the store when this ends."""
    delete, reached, go_on = state.blobs.delete, threading.Event(), threading.Event()

    def delete_later(key):
        reached.set()
        assert go_on.wait(PATIENCE_SECONDS)
        delete(key)

    with monkeypatch.context() as patch:
        patch.setattr(state.blobs, "delete", delete_later)
        deletion = in_thread(delete_orphans)
        assert reached.wait(PATIENCE_SECONDS)
        patch.setattr(state.blobs, "delete", delete)
        yield
        go_on.set()
        deletion.join(PATIENCE_SECONDS)


@contextlib.contextmanager
def deleted_once_sealed(state, monkeypatch, count):
    """Within: what is sealed is at once an orphan that is deleted, as by a worker whose clock is days ahead."""
    put_files = state.blobs.put_files

    def put_and_deleted(files):
        put_files(files)
        make_old(state.blobs)
        assert BlobDeleter(state.database, state.blobs).delete_orphans() == count

    with monkeypatch.context() as patch:
        patch.setattr(state.blobs, "put_files", put_and_deleted)
        yield


def assert_all_named_are_there(state):
    with state.database.read() as session:
        assert set(session.scalars(sa.select(MealImage.blob_key))) <= keys_of(state)


@pytest.fixture
def sending(phone, state, monkeypatch):
    return Sending(phone, state, monkeypatch)


@pytest.mark.both_stores
def test_photograph_acknowledged_during_orphan_deletion_stays(sending, state, monkeypatch):
    """The deletion is on its way to the store: it deletes what it finds there, whenever it gets there."""
    with deletion_on_its_way(state, monkeypatch, sending.delete_orphans):
        assert sending.send().status_code == 202
    sending.assert_kept()


def test_deleter_that_was_stopped_and_goes_on_long_after_another_took_its_place_deletes_no_photograph(
    sending, state, monkeypatch
):
    with deletion_on_its_way(state, monkeypatch, sending.delete_orphans):
        assert sending.delete_orphans() == 2
        assert sending.send().status_code == 202
    sending.assert_kept()


def test_photograph_whose_key_is_spent_after_sealing_is_refused_and_accepted_when_resent(sending, state, monkeypatch):
    with deleted_once_sealed(state, monkeypatch, 2):
        refused = sending.send()
    assert (refused.status_code, refused.json()["retryable"]) == (503, True)
    assert refused.headers["Retry-After"] == "1"
    assert sending.send().status_code == 202
    sending.assert_kept()


def test_orphan_that_is_named_since_the_first_look_stays(sending, state, monkeypatch):
    delete_orphans, answers = BlobDeleter._delete_orphans, []

    def sent_meanwhile(self, keys, before):
        if not answers:
            answers.append(sending.send())
            make_old(state.blobs)  # sealed again, it is young, or old by the clock of another machine
        return delete_orphans(self, keys, before)

    monkeypatch.setattr(BlobDeleter, "_delete_orphans", sent_meanwhile)
    assert sending.delete_orphans() == 0
    assert answers[0].status_code == 202
    sending.assert_kept()


@pytest.mark.both_stores
def test_orphan_whose_row_is_written_and_not_committed_stays(sending, state, monkeypatch):
    """PostgreSQL: the deleter cannot see the row, but that somebody holds the key. SQLite: it waits for its turn."""
    lock_meal, deletions = meals.lock_meal, []

    def while_orphans_are_deleted(session, meal_id):
        if not deletions:
            make_old(state.blobs)
            deletions.append(in_thread(sending.delete_orphans))
            if state.database.is_sqlite:
                wait_for_blocked_transaction(state.database)
            else:
                deletions[0].join(PATIENCE_SECONDS)
        return lock_meal(session, meal_id)

    monkeypatch.setattr(meals, "lock_meal", while_orphans_are_deleted)
    assert sending.send().status_code == 202
    deletions[0].join(PATIENCE_SECONDS)
    sending.assert_kept()


@pytest.mark.both_stores
def test_upload_of_a_key_being_spent_waits_and_is_refused(sending, state, monkeypatch):
    spend, uploads, answers = spent_keys.spend, [], []

    def while_it_is_sent(session, keys, now):
        spend(session, keys, now)
        session.flush()
        if not uploads:
            uploads.append(in_thread(lambda: answers.append(sending.send())))
            wait_for_blocked_transaction(state.database)
            assert answers == []

    monkeypatch.setattr(spent_keys, "spend", while_it_is_sent)
    sending.delete_orphans()
    uploads[0].join(PATIENCE_SECONDS)
    assert (answers[0].status_code, answers[0].json()["retryable"]) == (503, True)
    assert sending.send().status_code == 202
    sending.assert_kept()


def test_orphans_of_a_batch_are_spent_together_before_the_first_is_deleted_and_without_orphans_nothing_is_written(
    sending, state, monkeypatch
):
    spend, delete, done = spent_keys.spend, state.blobs.delete, []
    monkeypatch.setattr(spent_keys, "spend", lambda *given: (done.append(set(given[1])), spend(*given)))
    monkeypatch.setattr(state.blobs, "delete", lambda key: (done.append(key), delete(key)))
    assert sending.delete_orphans() == 2
    assert done == [sending.orphans, *sorted(sending.orphans)]
    monkeypatch.setattr(state.database, "write", out_of_order)
    assert sum(BlobDeleter(state.database, state.blobs).orphan_batches()) == 0


@pytest.mark.parametrize("kind", ["postgres"])  # SQLite has one writer at a time
def test_orphan_about_to_be_named_stays_and_the_rest_of_its_batch_is_deleted(sending, state):
    named, other = sorted(sending.orphans)
    with state.database.write() as session:
        spent_keys.hold(session, [named])
        assert sending.delete_orphans() == 1
    assert sending.orphans & keys_of(state) == {named}
    with state.database.read() as session:
        assert spent_keys.spent_among(session, sending.orphans) == {other}


def test_deleter_that_died_before_deleting_blocks_no_phone(sending, state, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(state.blobs, "delete", out_of_order)
        with pytest.raises(UnavailableError):
            sending.delete_orphans()
    assert sending.send().status_code == 202
    sending.assert_kept()


@pytest.mark.parametrize("when", ["deleted", "spent"])
def test_photograph_of_an_after_pair_whose_orphan_is_just_deleted_stays(when, phone, state, monkeypatch):
    table = Table(phone, state).measured()
    if when == "spent":
        with deleted_once_sealed(state, monkeypatch, 1):
            assert table.put("after_left").status_code == 503
        table.send_after()
    else:
        with monkeypatch.context() as patch:
            patch.setattr(SubmitAfterPair, "_write", out_of_order)
            assert table.put("after_left").status_code == 503
        make_old(state.blobs)
        deleter = BlobDeleter(state.database, state.blobs)
        with deletion_on_its_way(state, monkeypatch, deleter.delete_orphans):
            table.send_after()
    assert_all_named_are_there(state)


def test_photograph_replaced_by_another_pair_does_not_count_as_sealed(phone, state, monkeypatch):
    """Nothing of it was put into the store by this request, and its row goes with the pair that failed."""
    table = Table(phone, state).measured().send_after()
    table.after_measured(failure={"code": "marker_not_found", "message": "No board.", "advice": ""})
    write, answers = SubmitAfterPair._write, []

    def after_another_pair(self, *arguments):
        if not answers:
            answers.append(None)
            answers[0] = table.put("after_left", seed=99)
        return write(self, *arguments)

    monkeypatch.setattr(SubmitAfterPair, "_write", after_another_pair)
    late = table.put("after_right")
    assert answers[0].status_code == 202
    assert late.status_code == 409
    assert table.put("after_right").status_code == 202
    assert_all_named_are_there(state)


@pytest.mark.parametrize("kind", ["postgres"])  # on SQLite nothing is committed while the deleter looks
def test_result_of_a_job_that_ends_between_the_two_queries_is_not_an_orphan(phone, state):
    """Its run is not seen by the first, and its job is no longer under way for the second, were they the other way."""
    table, saved = Table(phone, state), []
    with state.database.read() as session:
        job = session.scalars(sa.select(Job)).one()
        sealed = f"{job.study_id}/{job.meal_id}/runs/{job.id}/result.json/{'a' * 64}"
    with state.database.write() as session:

        @sa.event.listens_for(session, "do_orm_execute")
        def ends_before_the_second_query(_):
            saved.append(None)
            if len(saved) == 2:
                run_id = estimates.save(state, table.id)
                with state.database.write() as other:
                    other.execute(sa.update(Run).where(Run.id == run_id).values(result_key=sealed))

        assert privacy.needed_keys(session, [sealed]) == {sealed}
    assert len(saved) >= 2
