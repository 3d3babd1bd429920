"""Read blobs for a backup and store them at a restore, a few at once: a store has latency."""

import errno
import hashlib
import re
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, TypeVar

from app.operations.backup.archive import BLOBS, PIECE_BYTES, ReportProgress, broken, members
from app.storage.blob_store import (
    KEY_PATTERN,
    BlobDamagedError,
    BlobMissingError,
    BlobStore,
    StoreRefusesError,
)

AT_ONCE = 4
AHEAD = 8  # blobs that were read and wait to be written
SHA256 = re.compile(r"^[0-9a-f]{64}$")

MISSING = "missing"  # the store does not have it
CHANGED = "its bytes are not those that were stored"
UNREADABLE = "the store cannot read it"
NO_KEY = "not a key of the store"

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class BlobCopy:
    """A blob that was read. path None: `fault` has the reason."""

    key: str
    path: Path | None
    fault: str = ""


def is_blob_key(key: str) -> bool:
    """Return whether this is a key of ours, which ends with the SHA-256 of the blob."""
    return KEY_PATTERN.match(key) is not None and SHA256.match(_sha256_of(key)) is not None


def read_blobs(blobs: BlobStore, keys: Iterable[str]) -> Iterator[BlobCopy]:
    """Yield copies of these blobs, in order; each is gone when the next is asked for.

    Raises OSError if the store does not answer.
    """
    with TemporaryDirectory(prefix="tada-blobs-") as folder:
        for copy in _ahead(lambda key: _read(blobs, key, Path(folder)), keys):
            yield copy
            if copy.path is not None:
                copy.path.unlink()


def store_blobs(file: IO[bytes], blobs: BlobStore, report: ReportProgress) -> None:
    """Store all blobs of a verified backup, durably. Repeating it is harmless. Raises OSError."""
    with TemporaryDirectory(dir=blobs.staging_folder()) as folder:
        staged = _staged_blobs(file, Path(folder))
        stored = _ahead(lambda blob: blobs.put_file(*blob), staged)
        for number, _ in enumerate(stored, start=1):
            report(f"restored: {number} blobs")


def _ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield the function's results in the order of the items, computed by a few threads."""
    remaining = iter(items)
    with ThreadPoolExecutor(AT_ONCE, thread_name_prefix="blobs") as threads:
        waiting = deque(threads.submit(function, item) for item in islice(remaining, AHEAD))
        while waiting:
            yield waiting.popleft().result()
            waiting.extend(threads.submit(function, item) for item in islice(remaining, 1))


def _read(blobs: BlobStore, key: str, folder: Path) -> BlobCopy:
    """Copy a blob, trying twice: if only this one fails, it is damaged; else raise OSError."""
    if not is_blob_key(key):
        return BlobCopy(key, None, NO_KEY)
    path = folder / uuid.uuid4().hex
    for _ in range(2):
        try:
            blobs.fetch(key, path)
            with path.open("rb") as file:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            is_whole = sha256 == _sha256_of(key)
            return BlobCopy(key, path) if is_whole else BlobCopy(key, None, CHANGED)
        except BlobMissingError:
            return BlobCopy(key, None, MISSING)
        except BlobDamagedError:  # detected by a remote store
            return BlobCopy(key, None, CHANGED)
        except OSError as error:
            if isinstance(error, StoreRefusesError) or error.errno != errno.EIO:
                raise
        next(blobs.keys("nobody/"), None)  # raises if the store itself fails
    return BlobCopy(key, None, UNREADABLE)


def _staged_blobs(file: IO[bytes], folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield the key of each blob of the archive, and a copy in this folder."""
    for name, _, content in members(file):
        if not name.startswith(BLOBS):
            continue
        digest, path = hashlib.sha256(), folder / uuid.uuid4().hex
        with path.open("wb") as copy:
            while piece := content.read(PIECE_BYTES):
                digest.update(piece)
                copy.write(piece)
        if digest.hexdigest() != _sha256_of(name):
            raise broken(f"{name} has been changed")
        yield name.removeprefix(BLOBS), path


def _sha256_of(key: str) -> str:
    return key.rpartition("/")[2]
