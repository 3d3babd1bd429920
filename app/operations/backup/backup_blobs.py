"""Blobs on their way into a backup: read a few at a time ahead, each checked against the SHA-256 in its key."""

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

READERS = 4  # at the same time: a remote store answers late, and its answers may overlap
AHEAD = 8  # blobs read and not yet written
IN_MEMORY_BYTES = 8 * 1024 * 1024  # of one blob; what is larger waits on disk
PIECE_BYTES = 256 * 1024
SHA256 = re.compile(r"^[0-9a-f]{64}$")

MISSING = "missing"  # the store does not have it
CHANGED = "its bytes are not those that were stored"
UNREADABLE = "the store cannot read it"
NO_KEY = "not a key of the store"


@dataclass(frozen=True, slots=True)
class ReadBlob:
    """A blob as it was read. content None: fault says why there is none. Close it."""

    key: str
    size: int
    content: IO[bytes] | None
    fault: str | None

    def pieces(self) -> Iterator[bytes]:
        """The bytes."""
        if self.content is None:
            raise ValueError(f"{self.key} was not read")
        while piece := self.content.read(PIECE_BYTES):
            yield piece

    def close(self) -> None:
        """Let go of the bytes."""
        if self.content is not None:
            self.content.close()


def is_blob_key(key: str) -> bool:
    """Whether it is a key as we make them, with the SHA-256 of its bytes at the end."""
    return KEY_PATTERN.match(key) is not None and SHA256.match(sha256_of_key(key)) is not None


def sha256_of_key(key: str) -> str:
    """What the bytes must come to."""
    return key.rpartition("/")[2]


def read_blobs(blobs: BlobStore, keys: Iterable[str]) -> Generator[ReadBlob, None, None]:
    """The blobs of these keys, in their order. Raises OSError where the store does not answer."""
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
            for left in waiting:
                left.add_done_callback(_close)
                left.cancel()


def _next(waiting: deque[Future[ReadBlob]]) -> Iterator[ReadBlob]:
    blob = waiting.popleft().result()
    try:
        yield blob
    finally:
        blob.close()


def _close(left: Future[ReadBlob]) -> None:
    if not left.cancelled() and left.exception() is None:
        left.result().close()


def _read(blobs: BlobStore, key: str) -> ReadBlob:
    """Twice at most: what cannot be read while the store answers is damaged; a store that is away damages nothing."""
    if not is_blob_key(key):
        return ReadBlob(key, 0, None, NO_KEY)
    for _ in range(2):
        try:
            return _read_once(blobs, key)
        except OSError as error:
            if isinstance(error, StoreRefusesError) or error.errno != errno.EIO:
                raise
        next(blobs.keys("nobody/"), None)  # raises where the fault is not this blob's
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
    except BlobDamagedError:  # a store on another machine noticed it by itself
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
