"""What only the store of files does; the contract of all stores is tests/integration/storage/test_stores.py."""

import errno
import os

import pytest

from app.core.settings import Settings
from app.storage.local import STAGING, LocalBlobStore
from app.storage.opening import open_blob_store

KEY = "study/meal/left/0123"


@pytest.fixture
def store(tmp_path):
    return LocalBlobStore(tmp_path / "blobs")


@pytest.fixture
def synced(monkeypatch):
    """What is synced, as paths, and "moved" for each file that is moved."""
    seen, sync, replace = [], os.fsync, os.replace

    def note_and_sync(handle):
        seen.append(os.path.realpath(f"/proc/self/fd/{handle}"))
        if seen[-1].endswith("/broken"):
            raise OSError(errno.EIO, "Input/output error")
        sync(handle)

    monkeypatch.setattr(os, "fsync", note_and_sync)
    monkeypatch.setattr(os, "replace", lambda *paths: seen.append("moved") or replace(*paths))
    return seen


def staged(store, name="file"):
    path = store.staging_folder() / name
    path.write_bytes(b"bytes")
    return path


@pytest.mark.parametrize("is_there", [False, True])  # made by another upload, which may not have synced them
def test_file_and_every_changed_folder_are_synced_before_put_returns(store, synced, is_there):
    if is_there:
        (store._root / "study" / "meal" / "left").mkdir(parents=True)
    store.put_file(KEY, staged(store))
    root = str(store._root)
    assert synced[0] == f"{store.staging_folder()}/file"
    assert {root, f"{root}/study", f"{root}/study/meal", f"{root}/study/meal/left"} <= set(synced)
    assert min(synced.index(folder) for folder in (root, f"{root}/study/meal")) > 0


def test_files_of_a_call_are_all_synced_before_any_is_moved_and_a_disk_that_fails_is_told(store, synced):
    left, right = staged(store, "a"), staged(store, "b")
    store.put_files({"study/meal/left/0": left, "study/meal/right/0": right})
    assert set(synced[:2]) == {str(left), str(right)}
    assert synced[2:4] == ["moved", "moved"]
    assert len(set(synced[4:])) == len(synced[4:]) == 5
    with pytest.raises(OSError, match="Input/output"):
        store.put_files({"study/meal/left/0": staged(store), "study/meal/right/0": staged(store, "broken")})


def test_url_opens_a_local_store_and_others_are_refused(tmp_path):
    store = open_blob_store(f"file://{tmp_path}/a%20b", Settings())
    assert store.staging_folder().parent == tmp_path / "a b" / STAGING
    with pytest.raises(Exception, match="TADA_BLOB_URL"):
        open_blob_store("ftp://somewhere", Settings())


def test_deleting_the_last_blob_of_a_folder_removes_the_empty_folders(store):
    store.put_bytes(KEY, b"x")
    store.put_bytes("study/other/left/0123", b"x")
    store.delete(KEY)
    left = sorted(path.name for path in store._root.rglob("*") if STAGING not in path.parts)
    assert left == ["0123", "left", "other", "study"]


def test_blob_is_put_though_its_folder_was_removed_as_empty_meanwhile(store, monkeypatch):
    replace, calls = os.replace, []

    def lose_and_replace(source, target):
        if not calls:
            target.parent.rmdir()
        calls.append(target)
        replace(source, target)

    monkeypatch.setattr(os, "replace", lose_and_replace)
    store.put_bytes(KEY, b"x")
    assert store.read(KEY) == b"x"
