"""Blobs as objects of an S3 bucket (AWS, MinIO, SeaweedFS and others), over obstore.

Every call is bounded in time: a few seconds to connect, PATIENCE for a response, a few attempts. An
object has its SHA-256 twice: as S3's checksum, which the server verifies, and in the object's
metadata, which is verified when the object is read. Objects are read in ranges, so a slow reader
holds neither memory nor a connection.
"""

import errno
import hashlib
import io
import mmap
import re
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
    StoreRefusesError,
    require_valid_key,
    require_valid_prefix,
)

CODE = re.compile(r"<Code>(\w+)</Code>")
STATUS = re.compile(r"non-2xx status code: (\d{3})")
FAULT = re.compile(r"kind: (Timeout|Connect)\b")
MACHINE_ROLE = "169.254.169.254"  # where AWS machines request keys if none are set

FULL_CODES = frozenset(
    {"XMinioStorageFull", "XMinioAdminBucketQuotaExceeded", "QuotaExceeded", "InsufficientStorage"}
)
REGION_CODES = frozenset(
    {"PermanentRedirect", "AuthorizationHeaderMalformed", "IllegalLocationConstraintException"}
)
if TYPE_CHECKING:
    from obstore.store import S3Config  # exists for type checking only

MEBIBYTE = 1024 * 1024
PART_BYTES = 8 * MEBIBYTE  # larger files are sent in parts, sequentially; S3's minimum is 5 MiB
BLOCK_BYTES = 1 * MEBIBYTE  # unit in which parts are read
PUTS_AT_ONCE = 4  # in one process; each holds about one part in memory
# each reading thread keeps a few of these, since malloc returns large blocks late
RANGE_BYTES = 512 * 1024
STREAM_BYTES = 256 * 1024  # forty threads may stream to slow phones
PAGE_KEYS = 1000  # S3's page size
PROBES = ".probe"  # no key begins with a full stop (KEY_PATTERN), so no listing shows a probe
DIGEST = "sha256"  # the object's metadata: x-amz-meta-sha256
EMPTY_SHA256 = hashlib.sha256().hexdigest()


def is_missing(text: str) -> bool:
    """Return whether the object is missing, but not the bucket."""
    return _status(text) == "404" and _code(text) != "NoSuchBucket"


def is_empty_range(text: str) -> bool:
    """Return whether the object does not have the requested bytes."""
    return _status(text) == "416"


def store_error(text: str, place: object) -> OSError:
    """Return the error to raise.

    place: for the log; the message contains no address, since /readyz shows it.
    """
    code, status = _code(text), _status(text)
    code_suffix = f" ({code})" if code else ""
    fault = FAULT.search(text)
    if MACHINE_ROLE in text:
        return _refusal("no key is set, and this machine has no role that provides one", place)
    if code == "NoSuchBucket":
        return _refusal("the bucket is not there", place)
    if code in REGION_CODES or "configured region" in text:
        return _refusal("the bucket is in another region than TADA_S3_REGION says", place)
    if status in ("401", "403"):
        return _refusal(f"the file store refuses our key{code_suffix}", place)
    if code in FULL_CODES or status == "507":
        return OSError(errno.ENOSPC, f"the file store is full{code_suffix}", str(place))
    if fault is not None and fault[1] == "Connect":
        return OSError(errno.ECONNREFUSED, "the file store cannot be reached", str(place))
    if fault is not None:
        return OSError(errno.ETIMEDOUT, "the file store does not answer in time", str(place))
    return OSError(
        errno.EIO,
        f"the file store answers with an error{code_suffix or (f' ({status})' if status else '')}",
        str(place),
    )


def _refusal(message: str, place: object) -> StoreRefusesError:
    return StoreRefusesError(errno.EIO, message, str(place))


def _code(text: str) -> str | None:
    match = CODE.search(text)
    return match[1] if match else None


def _status(text: str) -> str | None:
    match = STATUS.search(text)
    return match[1] if match else None


@dataclass(frozen=True, slots=True)
class S3Place:
    """Location and credentials.

    endpoint None: AWS; keys None: the SDK's chain (environment, web identity, machine).
    """

    bucket: str
    prefix: str
    region: str
    endpoint: str | None = None
    access_key_id: str | None = None
    secret_access_key: SecretStr | None = None

    def __str__(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}" + (
            f" at {self.endpoint}" if self.endpoint else ""
        )


@dataclass(frozen=True, slots=True)
class Patience:
    """Seconds to connect and for one response; at most `tries` attempts, none after `retry_seconds`."""

    connect_seconds: float = 3.0
    answer_seconds: float = 20.0
    retry_seconds: float = 10.0
    tries: int = 5
    turn_seconds: float = 20.0  # for other puts of this process to end


PATIENCE = Patience()
# readiness is checked often
PROBE_PATIENCE = Patience(connect_seconds=2.0, answer_seconds=4.0, retry_seconds=0.0, tries=1)


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
        """Send the file, in parts if it is large, then remove it."""
        require_valid_key(key)
        with source.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            length = file.tell()
            file.seek(0)
            with self._turn():
                self._put(
                    key,
                    _block(file, length) if length <= PART_BYTES else _blocks(file, length),
                    digest,
                )
        source.unlink()

    def put_files(self, files: Mapping[str, Path]) -> None:
        """Send the files one after the other, since a put holds its bytes in memory; other uploads run concurrently."""
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
        """Read all ranges."""
        return b"".join(self._ranges(key, RANGE_BYTES))

    def stream(self, key: str, chunk_bytes: int = STREAM_BYTES) -> Generator[bytes, None, None]:
        """Fetch the first range at once, and yield the content range by range."""
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
        """Fetch the first range at once, and yield the content range by range."""
        require_valid_key(key)
        first = self._range(key, start, min(STREAM_BYTES, length)) if length else b""

        def pieces() -> Generator[bytes, None, None]:
            block, place = first, start + len(first)
            while block:
                yield block
                remaining = start + length - place
                block = self._range(key, place, min(STREAM_BYTES, remaining)) if remaining else b""
                place += len(block)

        return pieces()

    def has(self, key: str) -> bool:
        """Request the first byte: unlike HEAD, S3 then reports whether the bucket is missing."""
        require_valid_key(key)
        try:
            with self._translate_errors(key):
                obstore.get(self._store, key, options={"range": (0, 1)}).bytes()
        except BlobMissingError:
            return False
        except _EmptyObjectError:
            return True
        return True

    def delete(self, key: str) -> None:
        """Delete the object; to S3 a missing one is not an error."""
        require_valid_key(key)
        try:
            with self._translate_errors(key):
                obstore.delete(self._store, key)
        except BlobMissingError:  # some servers report it
            return

    def keys(self, prefix: str = "") -> Iterator[StoredBlob]:
        """List page by page of a thousand, without objects whose names are not keys of ours."""
        require_valid_prefix(prefix)
        pages = obstore.list(self._store, prefix or None, chunk_size=PAGE_KEYS)
        while True:
            with self._translate_errors(None):
                page = next(pages, None)
            if page is None:
                return
            for entry in page:
                if KEY_PATTERN.match(entry["path"]):
                    yield StoredBlob(entry["path"], entry["last_modified"], entry["size"])

    def check(self) -> None:
        """Put and delete a probe that no listing shows."""
        key = f"{PROBES}/{uuid.uuid4().hex}"
        with self._translate_errors(key):
            result = obstore.put(self._probed, key, b"ok")
            obstore.delete(self._probed, key)
        self.keeps_versions = result["version"] not in (None, "null")

    @cached_property
    def _probed(self) -> S3Store:
        return _open(self._place, PROBE_PATIENCE)

    @contextmanager
    def _turn(self) -> Iterator[None]:
        if not self._turns.acquire(timeout=self._patience.turn_seconds):
            raise TimeoutError(
                errno.ETIMEDOUT, "too many uploads wait for the file store", str(self._place)
            )
        try:
            yield
        finally:
            self._turns.release()

    def _put(
        self, key: str, content: bytes | mmap.mmap | Iterator[bytes | mmap.mmap], digest: str
    ) -> None:
        with self._translate_errors(key):
            obstore.put(
                self._store,
                key,
                content,
                attributes={DIGEST: digest},
                chunk_size=PART_BYTES,
                max_concurrency=1,
            )

    def _ranges(self, key: str, range_bytes: int) -> Generator[bytes, None, None]:
        """Yield the object in ranges; yield the last one only if the SHA-256 of the whole matches."""
        require_valid_key(key)
        digest, start = hashlib.sha256(), 0
        while True:
            try:
                with self._translate_errors(key):
                    response = obstore.get(
                        self._store, key, options={"range": (start, start + range_bytes)}
                    )
                    block = bytes(response.bytes())
            except _EmptyObjectError:
                if start or not self._is_meant_empty(key):
                    raise BlobDamagedError(key) from None
                return
            digest.update(block)
            start += len(block)
            total_bytes = response.meta["size"]
            if start == total_bytes:
                if response.attributes.get(DIGEST, digest.hexdigest()) != digest.hexdigest():
                    raise BlobDamagedError(key)
                yield block
                return
            if len(block) != range_bytes:
                raise BlobDamagedError(key)
            yield block

    def _range(self, key: str, start: int, length: int) -> bytes:
        """Return exactly these bytes of the object."""
        try:
            with self._translate_errors(key):
                block = bytes(
                    obstore.get(
                        self._store, key, options={"range": (start, start + length)}
                    ).bytes()
                )
        except _EmptyObjectError:
            raise BlobDamagedError(key) from None
        if len(block) != length:
            raise BlobDamagedError(key)
        return block

    def _is_meant_empty(self, key: str) -> bool:
        with self._translate_errors(key):
            digest = obstore.get(self._store, key).attributes.get(DIGEST, EMPTY_SHA256)
        return digest == EMPTY_SHA256

    @contextmanager
    def _translate_errors(self, key: str | None) -> Iterator[None]:
        """Translate errors of obstore to ours, unchained, since their texts contain addresses and keys of blobs."""
        try:
            yield
        except (BaseError, FileNotFoundError) as error:
            text = str(error)
        else:
            return
        if is_empty_range(text):
            raise _EmptyObjectError from None
        if key is not None and is_missing(text):
            raise BlobMissingError(key) from None
        raise store_error(text, self._place) from None


class _EmptyObjectError(Exception):
    """A range was requested of an empty object."""


def _block(file: io.BufferedReader, length: int) -> bytes | mmap.mmap:
    """Return the next bytes of a file, in memory that is returned to the system at once.

    Memory from malloc stays with its thread: megabytes in each of the forty threads that handle
    uploads.
    """
    if not length:
        return b""  # mmap does not support length 0
    block = mmap.mmap(-1, length)
    if file.readinto(block) != length:
        raise OSError(errno.EIO, "a staged file was truncated while it was sent")
    return block


def _blocks(file: io.BufferedReader, length: int) -> Iterator[bytes | mmap.mmap]:
    for start in range(0, length, BLOCK_BYTES):
        yield _block(file, min(BLOCK_BYTES, length - start))


def _open(place: S3Place, patience: Patience) -> S3Store:
    config: S3Config = {
        "region": place.region,
        # without it SeaweedFS accepts altered bytes, though the signature covers them
        "checksum_algorithm": "SHA256",
        "disable_bulk_delete": True,  # some servers lack it, and we delete one object at a time
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
            "backoff": {
                "init_backoff": timedelta(seconds=0.2),
                "max_backoff": timedelta(seconds=2),
                "base": 2,
            },
        },
    )
