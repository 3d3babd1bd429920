"""The contract of a blob store. A blob has one owner and never changes; a key holds the SHA-256 of its content.

Keys: `study/meal/slot/sha256` for photographs, `study/meal/runs/run/name/sha256` for what a run made. Putting the same
key again is harmless, so an upload or a job that is tried again needs no clean-up first.
"""

import re
import shutil
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from app.core.errors import TadaError
from app.storage.staging import Staging

KEY_PATTERN = re.compile(r"^[A-Za-z0-9_][A-Za-z0-9_.-]*(/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$")


class BlobMissingError(TadaError):
    """The database names a blob that the store does not have: `tada doctor` lists them."""

    code = "blob_missing"
    status = 500

    def __init__(self, key: str) -> None:
        super().__init__("A file of this meal is not in the store. The people who run the server can see which.")
        self.add_note(f"blob key: {key}")  # in the log's traceback; the caller need not know our ids


class BlobDamagedError(TadaError):
    """The store gave other bytes than were put, or fewer: its disk or somebody's tool altered them."""

    code = "blob_damaged"
    status = 500

    def __init__(self, key: str) -> None:
        super().__init__("A file of this meal is damaged in the store. The people who run the server can see which.")
        self.add_note(f"blob key: {key}")


class StoreRefusesError(OSError):
    """The store answers, and will not serve us as we are set: a wrong key, a bucket that is not there.

    Its errno is one that passes (app/children/faults.py): meals wait until the setting is mended, and none fails by it.
    """


@dataclass(frozen=True, slots=True)
class StoredBlob:
    """A blob as a listing tells it: its key, when it was put there, its size in bytes."""

    key: str
    stored_at: datetime
    size: int


class BlobStore(ABC):
    """What the services need of a store. All calls block, for a bounded time; errors of the store are OSError.

    A store on another machine compares what it gives back with the SHA-256 of what was put: BlobDamagedError.
    keeps_versions: whether it keeps what is deleted, so that no erasure is one; None: not known, or not before `check`.
    """

    keeps_versions: bool | None = None

    def __init__(self, staging: Path) -> None:
        self._staging = Staging(staging)

    def staging_folder(self) -> Path:
        """A local folder for files in the making, from which `put_file` is cheapest."""
        return self._staging.folder

    def remove_abandoned(self) -> None:
        """Remove what processes that died left in the staging folder."""
        self._staging.remove_abandoned()

    def free_bytes(self) -> int:
        """Room left for uploads on this machine: where the blobs are, or for a store elsewhere the staging folder."""
        return shutil.disk_usage(self._staging.folder).free

    @abstractmethod
    def put_file(self, key: str, source: Path) -> None:
        """Move a finished local file under the key. When this returns, the blob is durable and the file gone."""

    @abstractmethod
    def put_files(self, files: Mapping[str, Path]) -> None:
        """As put_file, of several at once, by key. If it raises, some may be stored."""

    @abstractmethod
    def put_bytes(self, key: str, content: bytes) -> None:
        """Store bytes under the key. When this returns, the blob is durable."""

    def fetch(self, key: str, destination: Path) -> None:
        """Copy a blob to a local file. Raises BlobMissingError."""
        pieces = self.stream(key)
        with destination.open("wb") as file:
            file.writelines(pieces)

    def read(self, key: str) -> bytes:
        """A small blob's bytes. Raises BlobMissingError."""
        return b"".join(self.stream(key))

    @abstractmethod
    def stream(self, key: str, chunk_bytes: int = 256 * 1024) -> Generator[bytes, None, None]:
        """A blob's bytes piece by piece; close it if you do not read it to the end.

        Raises BlobMissingError before the first piece, BlobDamagedError instead of the last one.
        """

    @abstractmethod
    def stream_part(self, key: str, start: int, length: int) -> Generator[bytes, None, None]:
        """`length` bytes of a blob from `start` on, piece by piece; close it if you do not read it to the end.

        Raises BlobMissingError before the first piece, BlobDamagedError where the blob is too short. A part cannot be
        compared with what was put: whoever has all parts can.
        """

    @abstractmethod
    def has(self, key: str) -> bool:
        """Whether a blob is there."""

    @abstractmethod
    def delete(self, key: str) -> None:
        """Remove a blob; one that is not there is no error."""

    @abstractmethod
    def keys(self, prefix: str = "") -> Iterator[StoredBlob]:
        """All blobs whose keys begin with the prefix, which is empty or ends with a slash, in no order.

        What is put or deleted meanwhile may be listed or not.
        """

    @abstractmethod
    def check(self) -> None:
        """Raise OSError if the store cannot be written now."""


def require_valid_prefix(prefix: str) -> None:
    """Refuse a prefix that is neither empty nor a folder of keys."""
    if prefix and (not prefix.endswith("/") or not KEY_PATTERN.match(prefix[:-1])):
        raise ValueError(f"not a prefix of blob keys: {prefix!r}")


def require_valid_key(key: str) -> None:
    """Refuse a key that could leave the store's folder; keys are built by us, so this guards against our own bugs."""
    if not KEY_PATTERN.match(key):
        raise ValueError(f"not a blob key: {key!r}")
