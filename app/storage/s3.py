"""Blobs as objects of an S3 bucket (AWS, MinIO, SeaweedFS and others), over obstore.

Every call is bounded in time: a few seconds to connect, PATIENCE for an answer, a few tries. What is put carries its
SHA-256 twice: as S3's own checksum, which the server compares before it says yes, and as the object's metadata, which
is compared when the object is read. Objects are read in ranges, so a slow reader holds neither memory nor a connection.
"""

import errno
import hashlib
import io
import mmap
import threading
import uuid
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import obstore
from obstore.exceptions import BaseError
from obstore.store import S3Store
from pydantic import SecretStr

from app.storage.blob_store import (
    KEY_PATTERN,
    BlobDamagedError,
    BlobMissingError,
    BlobStore,
    StoredBlob,
    require_valid_key,
    require_valid_prefix,
)
from app.storage.s3_errors import is_empty_range, is_missing, store_error

if TYPE_CHECKING:
    from obstore.store import S3Config  # not there at run time

MEBIBYTE = 1024 * 1024
PART_BYTES = 8 * MEBIBYTE  # larger files go in parts, one after the other; S3 takes none under 5 MiB
BLOCK_BYTES = 1 * MEBIBYTE  # of a part in the making
PUTS_AT_ONCE = 4  # in one process: each holds about a part in memory
RANGE_BYTES = 512 * 1024  # each thread that reads keeps a few of these: malloc gives large blocks back late
STREAM_BYTES = 256 * 1024  # forty threads may stream to slow phones
PAGE_KEYS = 1000  # what S3 lists at a time
PROBES = ".probe"  # no key begins with a full stop (KEY_PATTERN), so no listing shows a probe
DIGEST = "sha256"  # the object's metadata: x-amz-meta-sha256
EMPTY_SHA256 = hashlib.sha256().hexdigest()


@dataclass(frozen=True, slots=True)
class S3Place:
    """Where the objects are. endpoint None: AWS; keys None: the SDK's chain (environment, web identity, machine)."""

    bucket: str
    prefix: str
    region: str
    endpoint: str | None = None
    access_key_id: str | None = None
    secret_access_key: SecretStr | None = None

    def __str__(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}" + (f" at {self.endpoint}" if self.endpoint else "")


@dataclass(frozen=True, slots=True)
class Patience:
    """Seconds to connect and for one answer; `tries` at most, and none after `retry_seconds`."""

    connect_seconds: float = 3.0
    answer_seconds: float = 20.0
    retry_seconds: float = 10.0
    tries: int = 5
    turn_seconds: float = 20.0  # for other puts of this process to end


PATIENCE = Patience()
PROBE_PATIENCE = Patience(
    connect_seconds=2.0, answer_seconds=4.0, retry_seconds=0.0, tries=1
)  # readiness is asked often


class S3BlobStore(BlobStore):
    """A BlobStore in a bucket, with a staging folder on this machine."""

    def __init__(self, place: S3Place, staging: Path, patience: Patience = PATIENCE) -> None:
        self._place = place
        super().__init__(staging)
        self._patience = patience
        self._store = _open(place, patience)
        self._turns = threading.BoundedSemaphore(PUTS_AT_ONCE)

    def __str__(self) -> str:
        return str(self._place)

    def put_file(self, key: str, source: Path) -> None:
        """Send the file, in parts if it is large; then remove it."""
        require_valid_key(key)
        with source.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            length = file.tell()
            file.seek(0)
            with self._turn():
                self._put(key, _block(file, length) if length <= PART_BYTES else _blocks(file, length), digest)
        source.unlink()

    def put_files(self, files: Mapping[str, Path]) -> None:
        """One after the other: those of other uploads go beside them, and a put holds its bytes in memory."""
        for key, source in files.items():
            self.put_file(key, source)

    def put_bytes(self, key: str, content: bytes) -> None:
        """Send the bytes."""
        require_valid_key(key)
        with self._turn():
            self._put(key, content, hashlib.sha256(content).hexdigest())

    def fetch(self, key: str, destination: Path) -> None:
        """Copy range by range."""
        ranges = self._ranges(key, RANGE_BYTES)
        with destination.open("wb") as file:
            file.writelines(ranges)

    def read(self, key: str) -> bytes:
        """All ranges at once."""
        return b"".join(self._ranges(key, RANGE_BYTES))

    def stream(self, key: str, chunk_bytes: int = STREAM_BYTES) -> Generator[bytes, None, None]:
        """Range by range; the first is there before the first piece is asked for."""
        ranges = self._ranges(key, STREAM_BYTES)
        first = next(ranges, b"")

        def pieces() -> Generator[bytes, None, None]:
            block = first
            while block:
                for start in range(0, len(block), chunk_bytes):
                    yield block[start : start + chunk_bytes]
                block = next(ranges, b"")

        return pieces()

    def stream_part(self, key: str, start: int, length: int) -> Generator[bytes, None, None]:
        """Range by range; the first is there before the first piece is asked for."""
        require_valid_key(key)
        first = self._range(key, start, min(STREAM_BYTES, length)) if length else b""

        def pieces() -> Generator[bytes, None, None]:
            block, place = first, start + len(first)
            while block:
                yield block
                left = start + length - place
                block = self._range(key, place, min(STREAM_BYTES, left)) if left else b""
                place += len(block)

        return pieces()

    def has(self, key: str) -> bool:
        """Ask for its first byte: unlike HEAD, S3 then says whether it is the bucket that is not there."""
        require_valid_key(key)
        try:
            with self._told(key):
                obstore.get(self._store, key, options={"range": (0, 1)}).bytes()
        except BlobMissingError:
            return False
        except _EmptyObjectError:
            return True
        return True

    def delete(self, key: str) -> None:
        """Remove the object; to S3 one that is not there is no error."""
        require_valid_key(key)
        try:
            with self._told(key):
                obstore.delete(self._store, key)
        except BlobMissingError:  # some servers say so
            return

    def keys(self, prefix: str = "") -> Iterator[StoredBlob]:
        """Page by page of a thousand; what stands in the bucket and is no key of ours is left out."""
        require_valid_prefix(prefix)
        pages = obstore.list(self._store, prefix or None, chunk_size=PAGE_KEYS)
        while True:
            with self._told(None):
                page = next(pages, None)
            if page is None:
                return
            for found in page:
                if KEY_PATTERN.match(found["path"]):
                    yield StoredBlob(found["path"], found["last_modified"], found["size"])

    def check(self) -> None:
        """Put and delete a probe that no listing shows."""
        key = f"{PROBES}/{uuid.uuid4().hex}"
        with self._told(key):
            made = obstore.put(self._probed, key, b"ok")
            obstore.delete(self._probed, key)
        self.keeps_versions = made["version"] not in (None, "null")

    @cached_property
    def _probed(self) -> S3Store:
        return _open(self._place, PROBE_PATIENCE)

    @contextmanager
    def _turn(self) -> Iterator[None]:
        if not self._turns.acquire(timeout=self._patience.turn_seconds):
            raise TimeoutError(errno.ETIMEDOUT, "too many uploads wait for the file store", str(self._place))
        try:
            yield
        finally:
            self._turns.release()

    def _put(self, key: str, content: bytes | mmap.mmap | Iterator[bytes | mmap.mmap], digest: str) -> None:
        with self._told(key):
            obstore.put(
                self._store,
                key,
                content,
                attributes={DIGEST: digest},
                chunk_size=PART_BYTES,
                max_concurrency=1,
            )

    def _ranges(self, key: str, range_bytes: int) -> Generator[bytes, None, None]:
        """The object in ranges; the last one comes only if the whole is what was put."""
        require_valid_key(key)
        digest, start = hashlib.sha256(), 0
        while True:
            try:
                with self._told(key):
                    found = obstore.get(self._store, key, options={"range": (start, start + range_bytes)})
                    block = bytes(found.bytes())
            except _EmptyObjectError:
                if start or not self._is_meant_empty(key):
                    raise BlobDamagedError(key) from None
                return
            digest.update(block)
            start += len(block)
            total_bytes = found.meta["size"]
            if start == total_bytes:
                if found.attributes.get(DIGEST, digest.hexdigest()) != digest.hexdigest():
                    raise BlobDamagedError(key)
                yield block
                return
            if len(block) != range_bytes:
                raise BlobDamagedError(key)
            yield block

    def _range(self, key: str, start: int, length: int) -> bytes:
        """These bytes of the object, all of them."""
        try:
            with self._told(key):
                block = bytes(obstore.get(self._store, key, options={"range": (start, start + length)}).bytes())
        except _EmptyObjectError:
            raise BlobDamagedError(key) from None
        if len(block) != length:
            raise BlobDamagedError(key)
        return block

    def _is_meant_empty(self, key: str) -> bool:
        with self._told(key):
            said = obstore.get(self._store, key).attributes.get(DIGEST, EMPTY_SHA256)
        return said == EMPTY_SHA256

    @contextmanager
    def _told(self, key: str | None) -> Iterator[None]:
        """Errors of obstore as ours; their texts hold addresses and keys of blobs, so they are not chained."""
        try:
            yield
        except (BaseError, FileNotFoundError) as error:
            said = str(error)
        else:
            return
        if is_empty_range(said):
            raise _EmptyObjectError from None
        if key is not None and is_missing(said):
            raise BlobMissingError(key) from None
        raise store_error(said, self._place) from None


class _EmptyObjectError(Exception):
    """A range was asked for of an object without bytes."""


def _block(file: io.BufferedReader, length: int) -> bytes | mmap.mmap:
    """The next bytes of a file, in memory that goes back to the system at once.

    What malloc gives stays with the thread that asked: megabytes in each of the forty threads that take uploads.
    """
    if not length:
        return b""  # no memory can be mapped for nothing
    block = mmap.mmap(-1, length)
    if file.readinto(block) != length:
        raise OSError(errno.EIO, "a staged file was cut while it was sent")
    return block


def _blocks(file: io.BufferedReader, length: int) -> Iterator[bytes | mmap.mmap]:
    for start in range(0, length, BLOCK_BYTES):
        yield _block(file, min(BLOCK_BYTES, length - start))


def _open(place: S3Place, patience: Patience) -> S3Store:
    config: S3Config = {
        "region": place.region,
        "checksum_algorithm": "SHA256",  # without it SeaweedFS takes altered bytes, though the signature covers them
        "disable_bulk_delete": True,  # some servers lack it, and we delete one at a time
    }
    if place.endpoint is not None:
        config["endpoint"] = place.endpoint
    if place.access_key_id is not None and place.secret_access_key is not None:
        config["access_key_id"] = place.access_key_id
        config["secret_access_key"] = place.secret_access_key.get_secret_value()
    return S3Store(
        place.bucket,
        prefix=place.prefix or None,
        config=config,
        client_options={
            "allow_http": place.endpoint is not None and place.endpoint.startswith("http://"),
            "connect_timeout": timedelta(seconds=patience.connect_seconds),
            "timeout": timedelta(seconds=patience.answer_seconds),
        },
        retry_config={
            "max_retries": patience.tries - 1,
            "retry_timeout": timedelta(seconds=patience.retry_seconds),
            "backoff": {"init_backoff": timedelta(seconds=0.2), "max_backoff": timedelta(seconds=2), "base": 2},
        },
    )
