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
    assert synced[0] == f"{store.staging_folder()}/file"
    assert {root, f"{root}/study", f"{root}/study/meal", f"{root}/study/meal/left"} <= set(synced)
    assert min(synced.index(folder) for folder in (root, f"{root}/study/meal")) > 0


def test_folders_that_another_upload_made_and_may_not_have_synced_are_synced_too(store, monkeypatch):
    (store._root / "study" / "meal" / "left").mkdir(parents=True)
    synced = []
    real = os.fsync
    monkeypatch.setattr(
        os, "fsync", lambda handle: synced.append(os.path.realpath(f"/proc/self/fd/{handle}")) or real(handle)
    )
    store.put_file(KEY, staged(store))
    root = str(store._root)
    assert {root, f"{root}/study", f"{root}/study/meal", f"{root}/study/meal/left"} <= set(synced)


def test_files_of_a_call_are_all_synced_before_any_is_moved(store, monkeypatch):
    left, right = (store.staging_folder() / name for name in ("a", "b"))
    for path in (left, right):
        path.write_bytes(b"x")
    seen = []
    real_sync, real_replace = os.fsync, os.replace
    monkeypatch.setattr(
        os, "fsync", lambda handle: seen.append(os.path.realpath(f"/proc/self/fd/{handle}")) or real_sync(handle)
    )
    monkeypatch.setattr(os, "replace", lambda *paths: seen.append("moved") or real_replace(*paths))
    store.put_files({"study/meal/left/0": left, "study/meal/right/0": right})
    assert set(seen[:2]) == {str(left), str(right)}
    assert seen[2:4] == ["moved", "moved"]
    assert len(set(seen[4:])) == len(seen[4:]) == 5


def test_disk_that_fails_to_sync_any_of_them_is_told(store, monkeypatch):
    real = os.fsync

    def broken(handle):
        if os.path.realpath(f"/proc/self/fd/{handle}").endswith("/right"):
            raise OSError(errno.EIO, "Input/output error")
        real(handle)

    monkeypatch.setattr(os, "fsync", broken)
    files = {}
    for slot in ("left", "right"):
        path = store.staging_folder() / f"new-{slot}"
        path.write_bytes(b"x")
        files[f"study/meal/{slot}/0"] = path
    with pytest.raises(OSError, match="Input/output"):
        store.put_files(files)


def test_url_opens_a_local_store_and_others_are_refused(tmp_path):
    store = open_blob_store(f"file://{tmp_path}/a%20b", Settings())
    assert store.staging_folder().parent == tmp_path / "a b" / STAGING
    with pytest.raises(Exception, match="TADA_BLOB_URL"):
        open_blob_store("ftp://somewhere", Settings())


def test_deleting_the_last_blob_of_a_folder_removes_the_empty_folders(store):
    store.put_bytes(KEY, b"x")
    store.put_bytes("study/other/left/0123", b"x")
    store.delete(KEY)
    assert sorted(path.name for path in store._root.rglob("*") if STAGING not in path.parts) == [
        "0123",
        "left",
        "other",
        "study",
    ]


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
