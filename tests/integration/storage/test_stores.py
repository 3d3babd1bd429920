"""The contract of a blob store (app/storage/blob_store.py), on files and on a real S3 server."""

import hashlib
import os
import time
import traceback
from concurrent.futures import ThreadPoolExecutor

import pytest

from app.storage.blob_store import BlobDamagedError, BlobMissingError

KEY = "study/meal/left/0123"
MEBIBYTE = 1024 * 1024


def staged(store, content=b"bytes", name="file"):
    path = store.staging_folder() / name
    path.write_bytes(content)
    return path


# None, one, and about the borders of ranges and parts
LENGTHS = (0, 1, 256 * 1024, 512 * 1024, 512 * 1024 + 1, 8 * MEBIBYTE, 16 * MEBIBYTE + 1)


def test_file_of_any_length_comes_back_as_it_was_put(store, tmp_path):
    for length in LENGTHS:
        content = os.urandom(length)
        path, key = staged(store, content), f"study/meal/left/{length}"
        store.put_file(key, path)
        assert not path.exists()
        assert store.read(key) == content
        store.fetch(key, tmp_path / "copy")
        assert (tmp_path / "copy").read_bytes() == content
        digest = hashlib.sha256()
        for piece in store.stream(key):
            digest.update(piece)
        assert digest.digest() == hashlib.sha256(content).digest()
        assert store.has(key)


def test_several_files_at_once_come_back_and_none_at_all_or_the_same_again_is_no_error(store):
    store.put_files({})
    files = {f"study/meal/{slot}/0": staged(store, slot.encode(), slot) for slot in ("left", "right")}
    store.put_files(files)
    assert [store.read(key) for key in files] == [b"left", b"right"]
    store.put_bytes("study/meal/left/0", b"left")
    assert store.read("study/meal/left/0") == b"left"
    assert list(store.staging_folder().iterdir()) == []


def test_same_key_put_by_many_at_once_is_whole(store):
    content = os.urandom(MEBIBYTE)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: store.put_file(KEY, staged(store, content, str(n))), range(8)))
    assert store.read(KEY) == content
    assert [blob.key for blob in store.keys("study/")] == [KEY]


def test_missing_blob_is_told_before_the_first_piece_by_name_in_the_log_alone_and_deleting_it_is_no_error(
    store, tmp_path
):
    store.put_bytes(KEY, b"x")
    store.delete(KEY)
    store.delete(KEY)
    for call in (
        lambda: store.read(KEY),
        lambda: store.stream(KEY),
        lambda: store.fetch(KEY, tmp_path / "x"),
        lambda: store.stream_part(KEY, 0, 5),
    ):
        with pytest.raises(BlobMissingError) as caught:
            call()
        assert "study/meal" not in caught.value.message
        assert KEY in "".join(traceback.format_exception(caught.value))
    assert not store.has(KEY)


def test_stream_gives_all_bytes_in_pieces_and_left_early_leaves_nothing_open(store):
    content = os.urandom(2 * MEBIBYTE)
    store.put_bytes(KEY, content)
    pieces = list(store.stream(KEY, chunk_bytes=1000))
    assert b"".join(pieces) == content
    assert max(map(len, pieces)) == 1000
    stream = store.stream(KEY)
    assert next(stream)
    stream.close()
    store.delete(KEY)
    assert not store.has(KEY)


def test_key_that_could_leave_the_store_and_prefix_that_is_no_folder_of_keys_are_refused_by_every_call(store, tmp_path):
    path = staged(store)
    for key in ("../out", "a/../b", "/etc/passwd", ".incoming/x", "", "a//b", "a/./b", "a\x00b"):
        for call in (
            lambda key: store.put_bytes(key, b"x"),
            lambda key: store.put_file(key, path),
            store.read,
            store.stream,
            lambda key: store.fetch(key, tmp_path / "x"),
            store.has,
            store.delete,
        ):
            with pytest.raises(ValueError, match="blob key"):
                call(key)
    for prefix in ("study", "/", "../", "a//", ".incoming/"):
        with pytest.raises(ValueError, match="prefix"):
            next(store.keys(prefix))


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


def test_more_keys_than_a_page_are_all_listed_once(store):
    wanted = {f"study/meal/left/{n}" for n in range(1050)}
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda key: store.put_bytes(key, b""), wanted))
    found = [blob.key for blob in store.keys("study/")]
    assert len(found) == len(wanted)
    assert set(found) == wanted


def test_keys_deleted_while_they_are_listed_make_no_error(store):
    keys = {f"study/meal/left/{n}" for n in range(20)}
    for key in keys:
        store.put_bytes(key, b"x")
    listed = []
    for blob in store.keys("study/"):
        listed.append(blob.key)
        for key in keys:
            store.delete(key)
    assert set(listed) <= keys
    assert list(store.keys()) == []


def test_check_of_a_store_that_can_be_written_leaves_nothing_and_its_room_is_the_staging_folder_s(store):
    store.check()
    assert list(store.keys()) == []
    assert list(store.staging_folder().iterdir()) == []
    vfs = os.statvfs(store.staging_folder())
    assert store.free_bytes() == pytest.approx(vfs.f_bavail * vfs.f_frsize, rel=0.05)  # others write meanwhile


def test_part_of_a_blob_is_those_bytes_of_it_and_one_that_it_does_not_have_is_told(store):
    content = os.urandom(700_000)
    store.put_bytes(KEY, content)
    for start, length in ((0, 0), (0, 1), (5, 300_000), (699_999, 1), (250_000, 450_000)):
        assert b"".join(store.stream_part(KEY, start, length)) == content[start : start + length]
    for start, length in ((699_900, 200), (800_000, 10)):
        with pytest.raises(BlobDamagedError):
            b"".join(store.stream_part(KEY, start, length))
