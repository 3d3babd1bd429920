"""A file in the making: bytes are counted and hashed on their way, signs of life are given, and the disk keeps room.

It lies in the store's staging folder, which is removed once its process has died.
"""

import contextlib
import hashlib
import os
import shutil
import tempfile
import threading
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import structlog
from sqlalchemy.exc import SQLAlchemyError

from app.core.errors import StorageFullError
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports.file_work_queries import Sums, Work
from app.privacy import queries as privacy

log = structlog.get_logger()

BEAT_SECONDS = 1.0
ROOM_CHECKED_EVERY_BYTES = 16 * 1024 * 1024


class ClaimLostError(Exception):
    """The work is not ours any more: called off, begun again by an erasure, or taken over while we slept."""


class WorkLife:
    """Beats for a claim, in a thread of its own, and knows how far the work is: rows and bytes are set by who writes.

    A database that does not answer is asked again; whether the claim still holds is asked once more at the end.
    """

    def __init__(self, database: Database, work: Work, claim: uuid.UUID, every_seconds: float = BEAT_SECONDS) -> None:
        self.rows = self.bytes = 0
        self._database, self._work, self._claim, self._every = database, work, claim, every_seconds
        self._ending, self._lost = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._beat, name="work-life", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def require_claim(self) -> None:
        """Raises ClaimLostError once a beat has met no claim of ours."""
        if self._lost.is_set():
            raise ClaimLostError

    def _beat(self) -> None:
        while not self._ending.wait(self._every):
            try:
                with self._database.write() as session:
                    is_ours = file_work.beat(session, self._work, self._claim, Sums(self.rows, self.bytes))
            except SQLAlchemyError as error:
                log.warning("work_beat_failed", error=type(error).__name__)
                continue
            if not is_ours:
                self._lost.set()
                return


class StagedFile:
    """A file in the staging folder that is being written. length and sha256: of what was written so far."""

    def __init__(self, path: Path, handle: int, life: WorkLife, min_free_bytes: int) -> None:
        self.path = path
        self.length = 0
        self._file = os.fdopen(handle, "wb", buffering=1024 * 1024)
        self._digest = hashlib.sha256()
        self._life, self._min_free_bytes = life, min_free_bytes
        self._checked_at = -ROOM_CHECKED_EVERY_BYTES

    @property
    def sha256(self) -> str:
        """Of the bytes so far."""
        return self._digest.hexdigest()

    def write(self, piece: bytes) -> None:
        """Append. Raises ClaimLostError, StorageFullError."""
        self._life.require_claim()
        if self.length - self._checked_at >= ROOM_CHECKED_EVERY_BYTES:
            self._checked_at = self.length
            if shutil.disk_usage(self.path.parent).free < self._min_free_bytes:
                raise StorageFullError("The disk has no room for the file.")
        self._file.write(piece)
        self._digest.update(piece)
        self.length += len(piece)
        self._life.bytes += len(piece)

    def write_all(self, pieces: Iterable[bytes]) -> None:
        """Append one after the other, then close. Raises as `write`."""
        for piece in pieces:
            self.write(piece)
        self.close()

    def close(self) -> None:
        """All is written."""
        self._file.close()


def file_key(kind: str, study_id: uuid.UUID, work_id: uuid.UUID, claim: uuid.UUID, *rest: str) -> str:
    """The key that a file gets in the store; another one at every try."""
    return "/".join((privacy.MADE_FILES, kind, str(study_id), str(work_id), claim.hex, *rest))


@contextmanager
def staged_file(folder: Path, life: WorkLife, min_free_bytes: int) -> Iterator[StagedFile]:
    """A new file; at the end it is gone, unless the store has moved it away."""
    handle, name = tempfile.mkstemp(prefix="made-", dir=folder)
    file = StagedFile(Path(name), handle, life, min_free_bytes)
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):  # a full disk, which the writer has told
            file.close()
        file.path.unlink(missing_ok=True)
