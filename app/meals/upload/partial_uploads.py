"""Photographs that arrive in pieces: one file per meal and slot, which grows over several requests and restarts.

A file is never complete here. When its last byte has come it is submitted as a photograph and
removed; until that has worked, the last byte counts as missing, so that the phone sends it again
and with it asks for the submission.
"""

import fcntl
import hashlib
import os
import tempfile
import time
import uuid
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import anyio
import anyio.to_thread

from app.core.errors import ConflictError, MalformedRequestError, NotFoundError, UnavailableError
from app.http.upload import WRITE_BYTES, ReceivedFile

KEPT_SECONDS = 24 * 3600  # after the last byte
MOST_PER_PARTICIPANT = 32  # 960 MiB of the largest photographs
BUSY_RETRY_SECONDS = 2
LENGTH_BYTES = 8  # at the file's beginning: the photograph's length, big-endian
HASH_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class UploadKey:
    """A photograph of a meal. participant: the row's id; meal: the phone's id."""

    participant: uuid.UUID
    meal: uuid.UUID
    slot: str


@dataclass(frozen=True, slots=True)
class UploadState:
    """offset: bytes that are here. length: bytes of the whole photograph."""

    offset: int
    length: int


class PartialUploads:
    """The unfinished uploads of this machine. All methods but `append` block for a short time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.remove_expired()

    def create(self, key: UploadKey, length: int) -> UploadState:
        """Begin an upload, or begin it anew.

        Raises ConflictError (`uploads_too_many`), UnavailableError.
        """
        self.remove_expired()
        folder = self._folder / key.participant.hex
        folder.mkdir(exist_ok=True)
        path = self._path(key)
        if not path.exists() and sum(1 for _ in folder.iterdir()) >= MOST_PER_PARTICIPANT:
            raise ConflictError(
                f"{MOST_PER_PARTICIPANT} uploads are unfinished, the limit: finish or delete one.",
                code="uploads_too_many",
                limit=MOST_PER_PARTICIPANT,
            )
        is_linked = False
        while not is_linked:  # another request may give the upload up between opening and locking
            with path.open("ab+") as file, _locked(file):
                file.truncate(0)
                file.write(length.to_bytes(LENGTH_BYTES))
                is_linked = os.fstat(file.fileno()).st_nlink > 0
        return UploadState(0, length)

    def state(self, key: UploadKey) -> UploadState:
        """Return an upload's offset and length. Raises NotFoundError."""
        try:
            with self._path(key).open("rb") as file:
                return _state(file)
        except FileNotFoundError:
            raise _no_upload() from None

    def discard(self, key: UploadKey) -> None:
        """Remove an upload, if there is one."""
        self._path(key).unlink(missing_ok=True)

    @contextmanager
    def opened(self, key: UploadKey, offset: int) -> Iterator["OpenUpload"]:
        """Open an upload to append at this offset; nobody else appends meanwhile.

        Raises NotFoundError, UnavailableError (`upload_busy`), ConflictError
        (`upload_offset_differs`).
        """
        try:
            file = self._path(key).open("rb+")
        except FileNotFoundError:
            raise _no_upload() from None
        with file, _locked(file):
            if not os.fstat(file.fileno()).st_nlink:
                raise _no_upload()
            state = _state(file)
            if offset != state.offset:
                raise ConflictError(
                    f"The upload is at byte {state.offset}: continue there.",
                    code="upload_offset_differs",
                    offset=state.offset,
                )
            yield OpenUpload(file, state)

    def remove_expired(self, now: float | None = None) -> None:
        """Remove uploads whose last byte came more than a day ago."""
        oldest = (time.time() if now is None else now) - KEPT_SECONDS
        for path in self._folder.glob("*/*"):
            try:
                if path.stat().st_mtime < oldest:
                    path.unlink()
            except FileNotFoundError:
                continue

    def _path(self, key: UploadKey) -> Path:
        return self._folder / key.participant.hex / f"{key.meal.hex}.{key.slot}"


class OpenUpload:
    """An upload that is open for appending."""

    def __init__(self, file: BinaryIO, state: UploadState) -> None:
        self._file, self._state = file, state

    async def append(
        self, pieces: AsyncIterator[bytes], limiter: anyio.CapacityLimiter
    ) -> UploadState:
        """Append the pieces as they arrive, and keep them if the connection breaks.

        Raises MalformedRequestError (`upload_too_long`).
        """
        offset, pending = self._state.offset, bytearray()
        self._file.seek(LENGTH_BYTES + offset)
        try:
            async for piece in pieces:
                if offset + len(pending) + len(piece) > self._state.length:
                    raise MalformedRequestError(
                        f"The upload has {self._state.length} bytes, as announced, and more were sent.",
                        code="upload_too_long",
                    )
                pending += piece
                if len(pending) >= WRITE_BYTES:
                    content, pending = bytes(pending), bytearray()
                    await anyio.to_thread.run_sync(self._file.write, content, limiter=limiter)
                    offset += len(content)
        finally:  # what came before the connection broke is kept
            self._file.write(pending)
            self._file.flush()
        return UploadState(offset + len(pending), self._state.length)

    def photograph(self, staging: Path) -> ReceivedFile:
        """Copy the whole photograph to the staging folder, from where its submission may move it.

        Blocks.
        """
        digest = hashlib.sha256()
        handle, name = tempfile.mkstemp(dir=staging)
        path = Path(name)
        self._file.seek(LENGTH_BYTES)
        try:
            with os.fdopen(handle, "wb") as whole:
                while piece := self._file.read(HASH_BYTES):
                    digest.update(piece)
                    whole.write(piece)
        except BaseException:  # such as a full disk, which a copy for each try would keep full
            path.unlink()
            raise
        return ReceivedFile(path, digest.hexdigest(), self._state.length)


def _state(file: BinaryIO) -> UploadState:
    """Raises NotFoundError for a file whose beginning a crash has prevented."""
    header = file.read(LENGTH_BYTES)
    if len(header) < LENGTH_BYTES:
        raise _no_upload()
    length = int.from_bytes(header)
    received = os.fstat(file.fileno()).st_size - LENGTH_BYTES
    return UploadState(min(received, length - 1), length)


@contextmanager
def _locked(file: BinaryIO) -> Iterator[None]:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UnavailableError(
            "Another request is sending this photograph.",
            code="upload_busy",
            retry_after_seconds=BUSY_RETRY_SECONDS,
        ) from None
    yield  # the lock goes with the file


def _no_upload() -> NotFoundError:
    return NotFoundError(
        "There is no unfinished upload of this photograph: begin one.", code="upload_unknown"
    )
