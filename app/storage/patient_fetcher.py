"""Fetch blobs with a deadline: a disk or a mount that hangs must not hold up what else its reader has to do."""

import threading
from concurrent.futures import Future
from pathlib import Path

from app.storage.blob_store import BlobStore

FETCH_SECONDS = 60.0  # of the largest photograph from the slowest store


class PatientFetcher:
    """Fetches blobs, each in a thread of its own; one that hangs keeps its thread, and no second one is begun."""

    def __init__(self, blobs: BlobStore, seconds: float = FETCH_SECONDS) -> None:
        self._blobs = blobs
        self._seconds = seconds
        self._hanging: dict[str, Future[None]] = {}

    def fetch(self, key: str, path: Path) -> None:
        """Copy a blob to a local file. Raises BlobMissingError, TimeoutError, OSError."""
        hanging = self._hanging.get(key)
        if hanging is not None and not hanging.done():
            raise TimeoutError(f"the store still hangs over {key}")
        fetched: Future[None] = Future()
        threading.Thread(
            target=self._fetch, args=(key, path, fetched), name="fetch", daemon=True
        ).start()
        try:
            fetched.result(self._seconds)
        except TimeoutError:
            self._hanging[key] = fetched
            raise
        self._hanging.pop(key, None)

    def _fetch(self, key: str, path: Path, fetched: Future[None]) -> None:
        try:
            self._blobs.fetch(key, path)
        except Exception as error:  # noqa: BLE001  # raised where the blob was asked for
            fetched.set_exception(error)
        else:
            fetched.set_result(None)
