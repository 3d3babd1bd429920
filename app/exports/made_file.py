"""Writing the files of exports and releases: counting and hashing bytes, heartbeats, free space.

Unfinished files are in the store's staging folder, which is removed after its process has died.
"""

import contextlib
import hashlib
import os
import shutil
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Generic, Self

import sqlalchemy as sa
import structlog
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.core.errors import StorageFullError
from app.core.settings import Settings
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.exports.file_work_queries import OneWork, Progress, Work
from app.storage.blob_store import BlobStore

MADE_FILES = "made"  # first part of the keys of a study's files
log = structlog.get_logger()

BEAT_SECONDS = 1.0
STATEMENT_SECONDS = 3600  # PostgreSQL; requests have a shorter limit
ROOM_CHECKED_EVERY_BYTES = 16 * 1024 * 1024


class ClaimLostError(Exception):
    """The claim is lost: the work was cancelled, restarted by an erasure, or taken over."""


class WorkLife:
    """Writes a claim's heartbeats in a thread of its own; the writer reports its rows and bytes.

    A failed heartbeat is retried; the last transaction checks the claim again.
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

    def count_rows(self, rows: int) -> None:
        """Add to the number of written rows."""
        self.rows += rows

    def count_bytes(self, length: int) -> None:
        """Add to the number of written bytes. Raises ClaimLostError once a heartbeat has found the claim lost."""
        if self._lost.is_set():
            raise ClaimLostError
        self.bytes += length

    def _beat(self) -> None:
        while not self._ending.wait(self._every):
            try:
                with self._database.write() as session:
                    is_ours = file_work.beat(session, self._work, self._claim, Progress(self.rows, self.bytes))
            except SQLAlchemyError as error:
                log.warning("work_beat_failed", error=type(error).__name__)
                continue
            if not is_ours:
                self._lost.set()
                return


class StagedFile:
    """A file that is being written in the staging folder. length, sha256: of the bytes so far."""

    def __init__(self, path: Path, handle: int, count_bytes: Callable[[int], None], min_free_bytes: int) -> None:
        self.path = path
        self.length = 0
        self._file = os.fdopen(handle, "wb", buffering=1024 * 1024)
        self._digest = hashlib.sha256()
        self._count_bytes, self._min_free_bytes = count_bytes, min_free_bytes
        self._checked_at = -ROOM_CHECKED_EVERY_BYTES

    @property
    def sha256(self) -> str:
        """SHA-256 of the bytes so far, hex."""
        return self._digest.hexdigest()

    def write(self, piece: bytes) -> None:
        """Append. Raises ClaimLostError, StorageFullError."""
        self._count_bytes(len(piece))
        if self.length - self._checked_at >= ROOM_CHECKED_EVERY_BYTES:
            self._checked_at = self.length
            if shutil.disk_usage(self.path.parent).free < self._min_free_bytes:
                raise StorageFullError("The disk has no room for the file.")
        self._file.write(piece)
        self._digest.update(piece)
        self.length += len(piece)

    def write_all(self, pieces: Iterable[bytes]) -> None:
        """Append all pieces, then close. Raises as `write`."""
        for piece in pieces:
            self.write(piece)
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@contextmanager
def staged_file(folder: Path, count_bytes: Callable[[int], None], min_free_bytes: int) -> Iterator[StagedFile]:
    """Open a new file; it is removed at the end unless it was moved. count_bytes: called with each piece's length."""
    handle, name = tempfile.mkstemp(prefix="made-", dir=folder)
    file = StagedFile(Path(name), handle, count_bytes, min_free_bytes)
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):  # a full disk, which the writer has reported
            file.close()
        file.path.unlink(missing_ok=True)


@contextmanager
def long_snapshot(database: Database) -> Iterator[Session]:
    """Open a read transaction of one moment with a statement timeout for large studies."""
    with database.read() as session:
        if not database.is_sqlite:
            session.execute(sa.text(f"SET LOCAL statement_timeout = {STATEMENT_SECONDS * 1000}"))
        yield session


class Attempt(Generic[OneWork]):
    """One attempt to make the files of an export or a release: staged, sealed, then named by the last transaction.

    Sealed blobs are removed at the end unless rows name them. They are kept if the last transaction raised, since it
    may have been committed; otherwise they are removed as orphans.
    """

    def __init__(
        self, database: Database, blobs: BlobStore, settings: Settings, work: OneWork, claim: uuid.UUID, life: WorkLife
    ) -> None:
        self.database, self.blobs, self.settings, self.work, self.life = database, blobs, settings, work, life
        self._claim = claim
        self._keys: list[str] = []
        self._is_named = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._is_named:
            for key in self._keys:
                self.blobs.delete(key)

    def new_file(self) -> AbstractContextManager[StagedFile]:
        """Open a file in the staging folder."""
        return staged_file(self.blobs.staging_folder(), self.life.count_bytes, self.settings.export_min_free_bytes)

    def seal(self, file: StagedFile, *names: str) -> str:
        """Move a file into the store; return its key, which differs for every attempt."""
        work = self.work
        parts = (MADE_FILES, f"{work.__tablename__}s", str(work.study_id), str(work.id), self._claim.hex)
        key = "/".join((*parts, *names, file.sha256))
        self.blobs.put_file(key, file.path)
        self._keys.append(key)
        return key

    def finish(self, is_unchanged: Callable[[Session], bool], end: Callable[[Session, OneWork], None]) -> bool:
        """Run the last transaction: if nothing relevant was erased meanwhile, `end` names the files.

        Returns False if the work has to begin again. The study is locked first, as in erasures (exports/queries.py).
        Raises ClaimLostError.
        """
        self._is_named = True  # must be assumed once the transaction has begun
        try:
            with self.database.write() as session:
                exports.lock_study(session, self.work.study_id, shared=True)
                held = file_work.hold(session, self.work, self._claim)
                if held is None:
                    raise ClaimLostError  # noqa: TRY301  # rolls the transaction back
                is_over = is_unchanged(session)
                if is_over:
                    end(session, held)
                    held.claim = held.heartbeat_at = None
                else:
                    file_work.begin_again(held, counts=False)
        except ClaimLostError:
            self._is_named = False
            raise
        self._is_named = is_over
        return is_over
