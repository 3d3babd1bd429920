"""A request's body to files in the staging folder, piece by piece: memory stays bounded, limits hold while it streams.

Multipart is parsed with python-multipart's low-level parser. Bytes are gathered to 128 KiB, then
written and hashed in a thread, of which at most `max_uploads` work at a time. Whatever ends the
request early (a limit, a cut connection) removes the files.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import anyio
import anyio.to_thread
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import Request

from app.core.errors import (
    MalformedRequestError,
    StorageFullError,
    TooLargeError,
    UnsupportedMediaError,
)
from app.http.state import ApiState
from app.photos.slots import image_name

WRITE_BYTES = 128 * 1024  # of each upload under way; larger ones are no faster
FRAME_BYTES = 64 * 1024  # boundaries and headers of the parts
MAX_BOUNDARY_LENGTH = 70  # RFC 2046, section 5.1.1
IMAGE_TYPES = ("image/jpeg", "image/png", "image/webp", "image/heic")  # those that are read
PHOTO_TYPES = frozenset(
    {*IMAGE_TYPES, "image/jpg", "image/heif", "image/tiff", "application/octet-stream"}
)
METADATA = "metadata"
MAX_METADATA_BYTES = 64 * 1024


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """A file in the staging folder, as it came: its SHA-256 and length were taken while it was written."""

    path: Path
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class UploadLimits:
    """Bytes of one photograph and of the metadata part, at most."""

    photo_bytes: int
    metadata_bytes: int


@dataclass(frozen=True, slots=True)
class ReceivedParts:
    """What a request held: the metadata's bytes, or None, and the photographs by slot."""

    metadata: bytes | None
    files: Mapping[str, ReceivedFile]


class _FileInTheMaking:
    """A staged file that takes bytes in large writes."""

    def __init__(self, folder: Path, name: str, limit: int) -> None:
        handle, path = tempfile.mkstemp(dir=folder)
        self.path = Path(path)
        self._file: BinaryIO = os.fdopen(handle, "wb")
        self._hash = hashlib.sha256()
        self._pending: list[bytes] = []
        self._pending_bytes = 0
        self._name = name
        self._limit = limit
        self._bytes = 0

    def add(self, data: bytes) -> None:
        """Take some bytes. Raises TooLargeError past the limit."""
        self._bytes += len(data)
        if self._bytes > self._limit:
            raise photo_too_large(self._name, self._limit)
        self._pending.append(data)
        self._pending_bytes += len(data)

    @property
    def wants_writing(self) -> bool:
        """Whether enough has gathered for a write."""
        return self._pending_bytes >= WRITE_BYTES

    def write(self) -> None:
        """Hash and write what has gathered. Blocks."""
        pieces, self._pending, self._pending_bytes = self._pending, [], 0
        for piece in pieces:
            self._hash.update(piece)
            self._file.write(piece)

    def finish(self) -> ReceivedFile:
        """Write the rest and close. Blocks."""
        self.write()
        self._file.close()
        return ReceivedFile(self.path, self._hash.hexdigest(), self._bytes)

    def discard(self) -> None:
        """Close and remove, wherever it stands."""
        with contextlib.suppress(OSError):  # what is still buffered may not fit the disk
            self._file.close()
        self.path.unlink(missing_ok=True)


@asynccontextmanager
async def received_parts(
    request: Request,
    slots: tuple[str, ...],
    staging: Path,
    limits: UploadLimits,
    limiter: anyio.CapacityLimiter,
    *,
    times: int = 1,
) -> AsyncIterator[ReceivedParts]:
    """The parts of a multipart request; their files are gone at the end unless the service has moved them.

    times: how often a slot may come; the second of `photo` is "photo 2" in the answer.
    """
    most = len(slots) * times * limits.photo_bytes + limits.metadata_bytes + FRAME_BYTES
    _require_declared(request, most)
    reader = _MultipartReader(_boundary(request), slots, staging, limits, times)
    received = 0
    try:
        async for chunk in request.stream():
            received += len(chunk)
            reader.feed(chunk)
            allowed = min(
                most, reader.files_begun * limits.photo_bytes + limits.metadata_bytes + FRAME_BYTES
            )
            # photographs have their own limits; this is what stands between and after them
            if received > allowed:
                raise _body_too_large(allowed)
            for file in reader.writable():
                await anyio.to_thread.run_sync(file.write, limiter=limiter)
        yield await anyio.to_thread.run_sync(reader.finish, limiter=limiter)
    finally:
        reader.discard()


@asynccontextmanager
async def received_body(
    request: Request, slot: str, staging: Path, limits: UploadLimits, limiter: anyio.CapacityLimiter
) -> AsyncIterator[ReceivedFile]:
    """The whole body as one photograph; its file is gone at the end unless the service has moved it."""
    _require_photo_type(request.headers.get("content-type", "application/octet-stream"), slot)
    declared = request.headers.get("content-length", "0")
    if declared.isdigit() and int(declared) > limits.photo_bytes:
        raise photo_too_large(slot, limits.photo_bytes)
    file = _FileInTheMaking(staging, slot, limits.photo_bytes)
    try:
        async for chunk in request.stream():
            file.add(chunk)
            if file.wants_writing:
                await anyio.to_thread.run_sync(file.write, limiter=limiter)
        yield await anyio.to_thread.run_sync(file.finish, limiter=limiter)
    finally:
        file.discard()


def _require_declared(request: Request, most: int) -> None:
    """Refuse by its Content-Length what cannot fit, before it is sent over a phone's network for nothing."""
    declared = request.headers.get("content-length", "0")
    if declared.isdigit() and int(declared) > most:
        raise _body_too_large(most)


def _body_too_large(most: int) -> TooLargeError:
    return TooLargeError(
        f"The body is larger than {most} bytes, the limit of all its parts.", limit_bytes=most
    )


def photo_too_large(slot: str, limit: int) -> TooLargeError:
    """Return the error for a photograph of more than `limit` bytes."""
    return TooLargeError(
        f"The {image_name(slot)} is larger than {limit} bytes, the limit.",
        code="image_too_large",
        slot=slot,
        limit_bytes=limit,
    )


def _boundary(request: Request) -> bytes:
    kind, options = parse_options_header(request.headers.get("content-type"))
    if kind != b"multipart/form-data":
        raise UnsupportedMediaError(
            "Send multipart/form-data with the parts that the API's documents name."
        )
    boundary = options.get(b"boundary", b"")
    if not boundary:
        raise MalformedRequestError("The content type names no multipart boundary.")
    if len(boundary) > MAX_BOUNDARY_LENGTH:
        raise MalformedRequestError(
            f"The multipart boundary is longer than {MAX_BOUNDARY_LENGTH} characters."
        )
    return boundary


def _require_photo_type(content_type: str, slot: str) -> None:
    kind, _ = parse_options_header(content_type)
    if kind.decode("latin-1").lower() not in PHOTO_TYPES:
        raise UnsupportedMediaError(
            f"The {slot} part is {content_type[:100]!r}: send a JPEG, PNG, WebP or HEIC as it came from the camera; a "
            "depth map as PNG or TIFF.",
            slot=slot,
        )


@dataclass(slots=True)
class _Part:
    """The part that is being read: its headers so far, then where its bytes go."""

    headers: dict[bytes, bytes] = field(default_factory=dict)
    header_name: bytearray = field(default_factory=bytearray)
    header_value: bytearray = field(default_factory=bytearray)
    name: str = ""


class _MultipartReader:
    """Turns the parser's callbacks into files and the metadata's bytes."""

    def __init__(
        self,
        boundary: bytes,
        slots: tuple[str, ...],
        staging: Path,
        limits: UploadLimits,
        times: int,
    ) -> None:
        self._slots = slots
        self._times = times
        self._staging = staging
        self._limits = limits
        self._part = _Part()
        self._metadata: bytearray | None = None
        self._files: dict[str, _FileInTheMaking] = {}
        self._ended = False
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._on_part_begin,
                "on_header_field": self._on_header_field,
                "on_header_value": self._on_header_value,
                "on_header_end": self._on_header_end,
                "on_headers_finished": self._on_headers_finished,
                "on_part_data": self._on_part_data,
                "on_end": self._on_end,
            },
        )

    def feed(self, chunk: bytes) -> None:
        """Parse some bytes. Raises MalformedRequestError, TooLargeError, UnsupportedMediaError."""
        try:
            self._parser.write(chunk)
        except FormParserError as error:
            raise MalformedRequestError(f"The multipart body cannot be read: {error}") from error

    def writable(self) -> list[_FileInTheMaking]:
        """Files that have gathered enough to be written."""
        return [file for file in self._files.values() if file.wants_writing]

    def finish(self) -> ReceivedParts:
        """Close the files. Raises MalformedRequestError if the closing boundary never came."""
        if not self._ended:
            raise MalformedRequestError(
                "The multipart body ends before its closing boundary.", code="body_incomplete"
            )
        metadata = bytes(self._metadata) if self._metadata is not None else None
        return ReceivedParts(metadata, {slot: file.finish() for slot, file in self._files.items()})

    @property
    def files_begun(self) -> int:
        """The number of photographs whose parts have begun."""
        return len(self._files)

    def discard(self) -> None:
        """Remove all files that are still in the staging folder."""
        for file in self._files.values():
            file.discard()

    def _on_part_begin(self) -> None:
        self._part = _Part()

    def _on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._part.header_name += data[start:end]

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._part.header_value += data[start:end]

    def _on_header_end(self) -> None:
        self._part.headers[bytes(self._part.header_name).lower()] = bytes(self._part.header_value)
        self._part.header_name, self._part.header_value = bytearray(), bytearray()

    def _on_headers_finished(self) -> None:
        _, options = parse_options_header(self._part.headers.get(b"content-disposition", b""))
        name = options.get(b"name", b"").decode("utf-8", "replace")
        names = (METADATA, *self._slots)
        if name not in names:
            raise MalformedRequestError(
                f"There is no part {name[:60]!r}; the parts are {', '.join(names)}.",
                code="part_unknown",
            )
        if name in self._slots:
            name = self._numbered(name)
        if name in self._files or (name == METADATA and self._metadata is not None):
            raise MalformedRequestError(f"The part {name} comes twice.", code="part_repeated")
        self._part.name = name
        if name == METADATA:
            self._metadata = bytearray()
            return
        _require_photo_type(
            self._part.headers.get(b"content-type", b"application/octet-stream").decode("latin-1"),
            name,
        )
        self._files[name] = _FileInTheMaking(self._staging, name, self._limits.photo_bytes)

    def _numbered(self, name: str) -> str:
        """The first name of this slot that is free, or the last that may be."""
        names = [name, *(f"{name} {number}" for number in range(2, self._times + 1))]
        return next((one for one in names if one not in self._files), names[-1])

    def _on_part_data(self, data: bytes, start: int, end: int) -> None:
        if self._part.name != METADATA:
            self._files[self._part.name].add(data[start:end])
            return
        metadata = self._metadata if self._metadata is not None else bytearray()
        metadata += data[start:end]
        if len(metadata) > self._limits.metadata_bytes:
            raise TooLargeError(
                f"The metadata part is larger than {self._limits.metadata_bytes} bytes, the limit.",
                code="metadata_too_large",
                limit_bytes=self._limits.metadata_bytes,
            )

    def _on_end(self) -> None:
        self._ended = True


RETRY_AFTER_SECONDS = 60


def require_room(state: ApiState) -> None:
    """Refuse an upload early while the disk is nearly full. Raises StorageFullError."""
    if state.blobs.free_bytes() < state.settings.min_free_bytes:
        raise storage_full()


def storage_full() -> StorageFullError:
    """Nothing was kept."""
    return StorageFullError(
        "The server's disk is nearly full. Nothing was kept: keep the meal on the phone and try again later.",
        retry_after_seconds=RETRY_AFTER_SECONDS,
    )
