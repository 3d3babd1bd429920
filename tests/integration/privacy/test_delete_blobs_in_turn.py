"""A blob that the store does not delete waits, and holds up no other erasure; a store that is away is not worn out."""

import errno
from datetime import UTC, datetime

import pytest

from app.people import privacy_queries as privacy
from app.people.privacy_models import BlobDeletion
from app.privacy import delete_blobs
from app.privacy.delete_blobs import MAX_CONSECUTIVE_FAULTS, BlobDeleter
from app.storage.local import LocalBlobStore

KEYS = [f"study/meal/left/{number}" for number in range(8)]


class StubbornStore(LocalBlobStore):
    """A folder from which some blobs cannot be deleted."""

    def __init__(self, root, stubborn):
        super().__init__(root)
        self.stubborn, self.asked = stubborn, []

    def delete(self, key):
        self.asked.append(key)
        if key in self.stubborn:
            raise OSError(errno.EIO, "input/output error")
        super().delete(key)


def stubborn_store(folder, database, stubborn):
    blobs = StubbornStore(folder, stubborn)
    for key in KEYS:
        blobs.put_bytes(key, b"of somebody who left")
    with database.write() as session:
        session.add_all(BlobDeletion(blob_key=key, requested_at=datetime.now(UTC)) for key in KEYS)
    return blobs


@pytest.mark.both_stores
def test_store_that_deletes_nothing_is_left_alone_for_a_while_and_one_stubborn_blob_holds_up_no_other(
    database, monkeypatch, tmp_path
):
    blobs = stubborn_store(tmp_path / "blobs", database, set(KEYS))
    deleter = BlobDeleter(database, blobs)
    with pytest.raises(OSError, match="input/output"):
        deleter.delete_scheduled()
    assert len(blobs.asked) == MAX_CONSECUTIVE_FAULTS
    with database.read() as session:
        assert privacy.scheduled_deletions(session, 10) == KEYS
    blobs.stubborn = {KEYS[0]}
    monkeypatch.setattr(delete_blobs, "BATCH", 4)
    for _ in range(3):
        with pytest.raises(OSError, match="input/output"):
            deleter.delete_scheduled()
    assert [blob.key for blob in blobs.keys()] == [KEYS[0]]  # noqa: SIM118  # no mapping
    with database.read() as session:
        assert privacy.scheduled_deletions(session, 10) == [KEYS[0]]
    blobs.stubborn.clear()
    assert deleter.delete_scheduled() == 1
    assert list(blobs.keys()) == []
