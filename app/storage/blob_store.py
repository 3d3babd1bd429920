"""The contract of a blob store.

A blob has one owner and never changes; its key ends with the SHA-256 of its content.

Keys: `study/meal/slot/sha256` for photographs, `study/meal/runs/run/name/sha256` for a run's
artefacts. Putting the same key again is harmless, so retrying an upload or a job needs no clean-up.
"""

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
import weakref
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from app.core.errors import TadaError

LOCK_SUFFIX = ".lock"
PARTIAL = "partial"
KEY_PATTERN = re.compile(r"^[A-Za-z0-9_][A-Za-z0-9_.-]*(/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$")


class Staging:
    """A private folder in `parent`, which is created if needed and cleared of dead processes' folders.

    Each open store has its own until its process ends. Beside each folder is a lock file that its
    process keeps locked. The kernel releases the lock with the process, so an abandoned folder is
    recognised at once and without a clock, which might jump and make current files look old.

    Raises OSError, also if the file system has no locks.
    """

    def __init__(self, parent: Path) -> None:
        parent.mkdir(parents=True, exist_ok=True)
        self._parent = parent
        self.remove_abandoned()
        lock, handle = _new_lock(parent)
        self.folder = lock.with_suffix("")
        self.folder.mkdir()
        weakref.finalize(self, _release, lock, handle)

    def partial_folder(self) -> Path:
        """Return the folder for uploads that are continued later, maybe by another process of this machine."""
        folder = self._parent / PARTIAL
        folder.mkdir(exist_ok=True)
        return folder

    def remove_abandoned(self) -> None:
        """Remove the folders of dead processes."""
        for path in list(self._parent.iterdir()):
            with contextlib.suppress(FileNotFoundError):  # another process is cleaning up too
                if path.suffix == LOCK_SUFFIX:
                    _remove_if_unlocked(path)


def _new_lock(parent: Path) -> tuple[Path, int]:
    """Create a locked file; return it and its open handle."""
    while True:
        handle, name = tempfile.mkstemp(suffix=LOCK_SUFFIX, dir=parent)
        fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:
            return Path(name), handle
        os.close(handle)  # another process removed it as abandoned before it was locked


def _remove_if_unlocked(lock: Path) -> None:
    with lock.open("rb+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return
        _remove(lock)


def _remove(lock: Path) -> None:
    """Remove the folder, then its lock."""
    with contextlib.suppress(FileNotFoundError):  # its process died before creating it
        shutil.rmtree(lock.with_suffix(""))
    lock.unlink(missing_ok=True)


def _release(lock: Path, handle: int) -> None:
    with contextlib.suppress(OSError):  # otherwise another process removes it later
        _remove(lock)
    os.close(handle)


class BlobMissingError(TadaError):
    """The store lacks a blob that the database names; `tada doctor` lists such blobs."""

    code = "blob_missing"
    status = 500

    def __init__(self, key: str) -> None:
        super().__init__(
            "A file of this meal is not in the store. The people who run the server can see which."
        )
        self.add_note(f"blob key: {key}")  # for the log's traceback; callers do not see our ids


class BlobDamagedError(TadaError):
    """The store returned different or fewer bytes than were put: they were altered on disk."""

    code = "blob_damaged"
    status = 500

    def __init__(self, key: str) -> None:
        super().__init__(
            "A file of this meal is damaged in the store. The people who run the server can see which."
        )
        self.add_note(f"blob key: {key}")


class StoreRefusesError(OSError):
    """The store refuses our configuration: a wrong key, a missing bucket.

    Its errno counts as temporary (app/children/faults.py): meals wait until the setting is fixed,
    and none fails.
    """


@dataclass(frozen=True, slots=True)
class StoredBlob:
    """An entry of a listing: key, time of storage, size in bytes."""

    key: str
    stored_at: datetime
    size: int


class BlobStore(ABC):
    """A blob store. All calls block for a bounded time; errors of the store are OSError.

    A remote store compares what it returns with the SHA-256 of what was put, and raises
    BlobDamagedError. keeps_versions: whether deleted blobs are kept, which defeats erasure; None:
    not known, or not before `check`.
    """

    keeps_versions: bool | None = None

    def __init__(self, staging: Path) -> None:
        self._staging = Staging(staging)

    def staging_folder(self) -> Path:
        """Return a local folder for temporary files, from which `put_file` is cheapest."""
        return self._staging.folder

    def partial_folder(self) -> Path:
        """Return the folder of unfinished uploads, on the staging folder's file system and kept over restarts."""
        return self._staging.partial_folder()

    def remove_abandoned(self) -> None:
        """Remove files that dead processes left in the staging folder."""
        self._staging.remove_abandoned()

    def free_bytes(self) -> int:
        """Return the free space for uploads on this machine: of the blobs' disk or a remote store's staging folder."""
        return shutil.disk_usage(self._staging.folder).free

    @abstractmethod
    def put_file(self, key: str, source: Path) -> None:
        """Move a complete local file to the key.

        When this returns, the blob is durable and the file is gone.
        """

    @abstractmethod
    def put_files(self, files: Mapping[str, Path]) -> None:
        """Put several files at once, by key. If it raises, some may be stored."""

    @abstractmethod
    def put_bytes(self, key: str, content: bytes) -> None:
        """Store bytes under the key. When this returns, the blob is durable."""

    def fetch(self, key: str, destination: Path) -> None:
        """Copy a blob to a local file. Raises BlobMissingError."""
        pieces = self.stream(key)
        with destination.open("wb") as file:
            file.writelines(pieces)

    def read(self, key: str) -> bytes:
        """Return a small blob's content. Raises BlobMissingError."""
        return b"".join(self.stream(key))

    @abstractmethod
    def stream(self, key: str, chunk_bytes: int = 256 * 1024) -> Generator[bytes, None, None]:
        """Yield a blob's content in pieces; close the generator unless you exhaust it.

        Raises BlobMissingError before the first piece, BlobDamagedError instead of the last one.
        """

    @abstractmethod
    def stream_part(self, key: str, start: int, length: int) -> Generator[bytes, None, None]:
        """Yield `length` bytes of a blob from `start` on, in pieces; close the generator unless you exhaust it.

        Raises BlobMissingError before the first piece, BlobDamagedError if the blob is too short. A
        part is not verified against the SHA-256; a caller with all parts can do so.
        """

    @abstractmethod
    def has(self, key: str) -> bool:
        """Return whether the blob exists."""

    @abstractmethod
    def delete(self, key: str) -> None:
        """Delete a blob; a missing one is not an error."""

    @abstractmethod
    def keys(self, prefix: str = "") -> Iterator[StoredBlob]:
        """Yield all blobs whose keys begin with the prefix, which is empty or ends with a slash, unordered.

        Blobs put or deleted meanwhile may be listed or not.
        """

    @abstractmethod
    def check(self) -> None:
        """Raise OSError if the store is not writable."""


def require_valid_prefix(prefix: str) -> None:
    """Raise ValueError for a prefix that is neither empty nor a folder of keys."""
    if prefix and (not prefix.endswith("/") or not KEY_PATTERN.match(prefix[:-1])):
        raise ValueError(f"not a prefix of blob keys: {prefix!r}")


def require_valid_key(key: str) -> None:
    """Raise ValueError for a key that could escape the store's folder; we build all keys, so this catches our bugs."""
    if not KEY_PATTERN.match(key):
        raise ValueError(f"not a blob key: {key!r}")
