"""Blobs are fetched with a deadline."""

import contextlib
import os

import pytest

from app.storage.local import LocalBlobStore
from app.storage.patient_fetcher import PatientFetcher
from tests.support.waiting import wait_until

KEY = "study/meal/left/0123"


def test_file_that_hangs_is_given_up_asked_for_once_and_read_when_it_answers_again(tmp_path):
    path = tmp_path / "blobs" / KEY
    path.parent.mkdir(parents=True)
    os.mkfifo(path)  # opening it waits for a writer, as a file on a mount that is away does
    fetcher = PatientFetcher(LocalBlobStore(tmp_path / "blobs"), seconds=0.1)
    with pytest.raises(TimeoutError):
        fetcher.fetch(KEY, tmp_path / "first")
    with pytest.raises(TimeoutError, match="still hangs"):
        fetcher.fetch(KEY, tmp_path / "second")
    path.write_bytes(b"late")  # the first one ends
    path.unlink()
    path.write_bytes(b"photograph")

    def is_read():
        with contextlib.suppress(TimeoutError):
            fetcher.fetch(KEY, tmp_path / "third")
            return True

    wait_until(is_read, "the store to answer again")
    assert (tmp_path / "third").read_bytes() == b"photograph"
