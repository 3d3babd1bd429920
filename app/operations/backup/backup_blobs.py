"""Read blobs for a backup, a few ahead, each verified against the SHA-256 in its key."""

import errno
import hashlib
import re
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from tempfile import SpooledTemporaryFile
from typing import IO

from app.storage.blob_store import KEY_PATTERN, BlobDamagedError, BlobMissingError, BlobStore, StoreRefusesError

READERS = 4  # concurrent, since a remote store has latency
AHEAD = 8  # blobs read and not yet written
IN_MEMORY_BYTES = 8 * 1024 * 1024  # of one blob; larger ones are spooled to disk
PIECE_BYTES = 256 * 1024
SHA256 = re.compile(r"^[0-9a-f]{64}$")

MISSING = "missing"  # the store does not have it
CHANGED = "its bytes are not those that were stored"
UNREADABLE = "the store cannot read it"
NO_KEY = "not a key of the store"


@dataclass(frozen=True, slots=True)
class ReadBlob:
    """The result of reading a blob. content None: `fault` has the reason. Close it after use."""

    key: str
    size: int
    content: IO[bytes] | None
    fault: str | None

    def pieces(self) -> Iterator[bytes]:
        """Yield the content."""
        if self.content is None:
            raise ValueError(f"{self.key} was not read")
        while piece := self.content.read(PIECE_BYTES):
            yield piece

    def close(self) -> None:
        """Release the content."""
        if self.content is not None:
            self.content.close()


def is_blob_key(key: str) -> bool:
    """Return whether this is a key of ours, which ends with the SHA-256 of the blob."""
    return KEY_PATTERN.match(key) is not None and SHA256.match(sha256_of_key(key)) is not None


def sha256_of_key(key: str) -> str:
    """Return the SHA-256 in a key."""
    return key.rpartition("/")[2]


def read_blobs(blobs: BlobStore, keys: Iterable[str]) -> Generator[ReadBlob, None, None]:
    """Yield the blobs of these keys, in order. Raises OSError if the store does not answer."""
    remaining, waiting = iter(keys), deque[Future[ReadBlob]]()
    with ThreadPoolExecutor(READERS, thread_name_prefix="backup") as readers:
        try:
            for key in remaining:
                waiting.append(readers.submit(_read, blobs, key))
                if len(waiting) >= AHEAD:
                    yield from _next(waiting)
            while waiting:
                yield from _next(waiting)
        finally:
            for future in waiting:
                future.add_done_callback(_close)
                future.cancel()


def _next(waiting: deque[Future[ReadBlob]]) -> Iterator[ReadBlob]:
    blob = waiting.popleft().result()
    try:
        yield blob
    finally:
        blob.close()


def _close(future: Future[ReadBlob]) -> None:
    if not future.cancelled() and future.exception() is None:
        future.result().close()


def _read(blobs: BlobStore, key: str) -> ReadBlob:
    """Read a blob, trying twice: if only this blob fails, it is damaged; if the store is down, raise OSError."""
    if not is_blob_key(key):
        return ReadBlob(key, 0, None, NO_KEY)
    for _ in range(2):
        try:
            return _read_once(blobs, key)
        except OSError as error:
            if isinstance(error, StoreRefusesError) or error.errno != errno.EIO:
                raise
        next(blobs.keys("nobody/"), None)  # raises if the store itself fails
    return ReadBlob(key, 0, None, UNREADABLE)


def _read_once(blobs: BlobStore, key: str) -> ReadBlob:
    content = SpooledTemporaryFile(IN_MEMORY_BYTES)  # noqa: SIM115  # ReadBlob.close
    try:
        digest, size = hashlib.sha256(), 0
        for piece in blobs.stream(key, PIECE_BYTES):
            digest.update(piece)
            content.write(piece)
            size += len(piece)
    except BlobMissingError:
        content.close()
        return ReadBlob(key, 0, None, MISSING)
    except BlobDamagedError:  # detected by a remote store
        content.close()
        return ReadBlob(key, 0, None, CHANGED)
    except BaseException:
        content.close()
        raise
    if digest.hexdigest() != sha256_of_key(key):
        content.close()
        return ReadBlob(key, size, None, CHANGED)
    content.seek(0)
    return ReadBlob(key, size, content, None)
