"""Who lists the store for orphans, and when; what of a listing's answer counts as missing."""

import os
import socket
import uuid
from datetime import timedelta
from types import SimpleNamespace

import pytest

from app.privacy.delete_blobs import SLICE_SECONDS, BlobDeleter, OrphanRounds, Pace
from app.privacy.missing_blobs import find_missing
from app.storage.opening import open_blob_store
from tests.integration.people.persons import Person
from tests.support.stores import make_old

HOURLY = Pace(interval=timedelta(hours=1), first_after=timedelta(0))


@pytest.fixture
def clock():
    return SimpleNamespace(seconds=1000.0)


@pytest.fixture
def orphans(state, enrol):
    """Three blobs of a known study that no row names, two days old."""
    person = Person(state, enrol, "somebody", seed=1)
    study_id = next(iter(state.blobs.keys())).key.split("/")[0]
    keys = [f"{study_id}/{uuid.uuid4()}/left/{n * 64}" for n in "abc"]
    for key in keys:
        state.blobs.put_bytes(key, b"x")
    make_old(state.blobs, keys)
    assert person.meal_id
    return keys


def rounds(state, clock, pace=HOURLY):
    return OrphanRounds(state.database, BlobDeleter(state.database, state.blobs), pace, lambda: clock.seconds)


def workers(monkeypatch, *alive):
    found = [SimpleNamespace(host=host, pid=pid) for host, pid in alive]
    monkeypatch.setattr("app.privacy.delete_blobs.living_workers", lambda _: found)


def test_oldest_worker_deletes_orphans_and_the_others_leave_it_to_it(state, orphans, clock, monkeypatch):
    us, other = (socket.gethostname(), os.getpid()), ("another-host", os.getpid())
    workers(monkeypatch, other, us)
    assert rounds(state, clock).run_slice() == 0
    workers(monkeypatch, us, other)
    assert rounds(state, clock).run_slice() == 3
    assert not any(state.blobs.has(key) for key in orphans)


def test_round_begins_when_it_is_due_and_not_before(state, orphans, clock):
    late = rounds(state, clock, Pace(interval=timedelta(days=1), first_after=timedelta(hours=1)))
    assert late.run_slice() == 0
    clock.seconds += 3601
    assert late.run_slice() == 3
    state.blobs.put_bytes(orphans[0], b"x")
    make_old(state.blobs, orphans[:1])
    clock.seconds += 86_000
    assert late.run_slice() == 0
    clock.seconds += 401
    assert late.run_slice() == 1


def test_long_round_is_done_in_slices(state, orphans, clock, monkeypatch):
    monkeypatch.setattr("app.privacy.delete_blobs.BATCH", 1)
    ours = rounds(state, clock)
    delete = ours._deleter._delete_orphans

    def slow(keys, before):
        clock.seconds += SLICE_SECONDS
        return delete(keys, before)

    monkeypatch.setattr(ours._deleter, "_delete_orphans", slow)
    assert [ours.run_slice() for _ in range(4)] == [1, 1, 1, 0]


def test_round_that_fails_is_begun_again_when_it_is_due(state, orphans, clock, monkeypatch):
    ours = rounds(state, clock)
    with monkeypatch.context() as patch:
        patch.setattr(state.blobs, "delete", lambda _: (_ for _ in ()).throw(TimeoutError("no answer")))
        with pytest.raises(TimeoutError):
            ours.run_slice()
    clock.seconds += 3601
    assert ours.run_slice() == 3


def test_missing_blobs_are_found_by_one_listing_and_those_that_came_after_it_are_not_missing(
    state, orphans, settings, monkeypatch
):
    fresh = open_blob_store(settings.resolved_blob_url, settings)
    there = [blob.key for blob in fresh.keys()]  # noqa: SIM118
    gone = [f"study/meal/left/{n}" for n in range(1500)]
    found = find_missing([*there, *gone], fresh)
    assert (found.total, found.missing) == (len(there) + 1500, 1500)
    assert found.first == tuple(gone[:1000])
    assert find_missing(there, fresh).missing == 0
    assert find_missing([], fresh).total == 0
    monkeypatch.setattr(state.blobs, "keys", lambda prefix="": iter(()))
    assert find_missing([*orphans, gone[0]], state.blobs).first == (gone[0],)
