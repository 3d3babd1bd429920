"""What only the store of files does; the contract of all stores is tests/integration/storage/test_stores.py."""

import os
import time

import pytest

from app.settings import Settings
from app.storage.local import LocalBlobStore
from app.storage.opening import open_blob_store
from app.storage.staging import ABANDONED_SECONDS

KEY = "study/meal/left/0123"


@pytest.fixture
def store(tmp_path):
    return LocalBlobStore(tmp_path / "blobs")


def staged(store, content=b"bytes"):
    path = store.staging_folder() / "file"
    path.write_bytes(content)
    return path


def test_file_and_every_changed_folder_are_synced_before_put_returns(store, monkeypatch):
    synced = []
    real = os.fsync
    monkeypatch.setattr(
        os, "fsync", lambda handle: synced.append(os.path.realpath(f"/proc/self/fd/{handle}")) or real(handle)
    )
    store.put_file(KEY, staged(store))
    root = str(store._root)
    assert synced[0] == f"{root}/.incoming/file"
    assert {root, f"{root}/study", f"{root}/study/meal", f"{root}/study/meal/left"} <= set(synced)
    assert synced[-1] == f"{root}/study/meal/left"


def test_abandoned_staged_files_go_at_the_next_start_and_young_ones_stay(store):
    old, young = store.staging_folder() / "old", store.staging_folder() / "young"
    old.write_bytes(b"x")
    young.write_bytes(b"x")
    past = time.time() - ABANDONED_SECONDS - 60
    os.utime(old, (past, past))
    LocalBlobStore(store._root)
    assert not old.exists()
    assert young.exists()


def test_url_opens_a_local_store_and_others_are_refused(tmp_path):
    assert open_blob_store(f"file://{tmp_path}/a%20b", Settings()).staging_folder() == tmp_path / "a b" / ".incoming"
    with pytest.raises(Exception, match="TADA_BLOB_URL"):
        open_blob_store("ftp://somewhere", Settings())


def test_deleting_the_last_blob_of_a_folder_removes_the_empty_folders(store):
    store.put_bytes(KEY, b"x")
    store.put_bytes("study/other/left/0123", b"x")
    store.delete(KEY)
    assert sorted(path.name for path in store._root.rglob("*")) == [".incoming", "0123", "left", "other", "study"]


def test_blob_is_put_though_its_folder_was_removed_as_empty_meanwhile(store, monkeypatch):
    make, calls = store._make_durable_folder, []

    def make_and_lose(folder):
        make(folder)
        if not calls:
            folder.rmdir()
        calls.append(folder)

    monkeypatch.setattr(store, "_make_durable_folder", make_and_lose)
    store.put_bytes(KEY, b"x")
    assert store.read(KEY) == b"x"
