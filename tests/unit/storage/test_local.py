import os
import time
import traceback

import pytest

from app.settings import Settings
from app.storage.blob_store import BlobMissingError
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


def test_put_file_moves_the_file_under_its_key(store):
    path = staged(store)
    store.put_file(KEY, path)
    assert store.read(KEY) == b"bytes"
    assert not path.exists()


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


def test_putting_the_same_key_again_is_harmless(store):
    store.put_bytes(KEY, b"bytes")
    store.put_bytes(KEY, b"bytes")
    assert store.read(KEY) == b"bytes"
    assert list(store.staging_folder().iterdir()) == []


def test_missing_blob_is_told_before_the_first_piece(store, tmp_path):
    for call in (lambda: store.read(KEY), lambda: store.stream(KEY), lambda: store.fetch(KEY, tmp_path / "x")):
        with pytest.raises(BlobMissingError):
            call()


def test_stream_gives_all_bytes_in_pieces(store):
    store.put_bytes(KEY, bytes(range(256)) * 10)
    pieces = list(store.stream(KEY, chunk_bytes=100))
    assert b"".join(pieces) == bytes(range(256)) * 10
    assert max(map(len, pieces)) == 100


def test_delete_of_a_missing_blob_is_no_error(store):
    store.put_bytes(KEY, b"x")
    store.delete(KEY)
    store.delete(KEY)
    with pytest.raises(BlobMissingError):
        store.read(KEY)


@pytest.mark.parametrize("key", ["../out", "a/../b", "/etc/passwd", ".incoming/x", "", "a//b", "a/./b", "a\x00b"])
def test_key_that_could_leave_the_folder_is_refused(store, key):
    with pytest.raises(ValueError, match="blob key"):
        store.put_bytes(key, b"x")


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


def test_keys_lists_what_is_stored_under_a_prefix_and_nothing_staged(store):
    for key in ("study/meal/left/0123", "study/meal2/left/4567", "study/meal/runs/1/topview.jpg/89"):
        store.put_bytes(key, b"x")
    staged(store)
    assert {blob.key for blob in store.keys("study/meal/")} == {
        "study/meal/left/0123",
        "study/meal/runs/1/topview.jpg/89",
    }
    everything = list(store.keys())
    assert len(everything) == 3
    assert list(store.keys("nobody/")) == []
    assert all(abs(blob.stored_at.timestamp() - time.time()) < 60 for blob in everything)


@pytest.mark.parametrize("prefix", ["study", "/", "../", "a//", ".incoming/"])
def test_prefix_that_is_no_folder_of_keys_is_refused(store, prefix):
    with pytest.raises(ValueError, match="prefix"):
        next(store.keys(prefix))


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


def test_missing_blob_is_named_in_the_log_and_not_to_the_caller(store):
    with pytest.raises(BlobMissingError) as caught:
        store.read("study/meal/left/abc")
    assert "study/meal" not in caught.value.message
    assert "study/meal/left/abc" in "".join(traceback.format_exception(caught.value))
