"""The files of exports and releases while they are made: heartbeats of the claim, hashing, sealing.

Unfinished files are in the store's staging folder, which is removed after its process has died.
"""

import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Self

import structlog
from pydantic import JsonValue
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.core.settings import Settings
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.exports.file_task import FileTasks
from app.exports.file_work_queries import OneWork, Progress, Work
from app.meals.stored.receive_photo import sha256_of_file
from app.storage.blob_store import BlobStore

MADE_FILES = "made"  # first part of the keys of a study's files
log = structlog.get_logger()

BEAT_SECONDS = 1.0
MOST_SECONDS = 6 * 3600.0  # of a task
NICENESS = 10  # more than the worker's own: estimates and heartbeats go first


class ClaimLostError(Exception):
    """The claim is lost: the work was cancelled, restarted by an erasure, or taken over."""


class AskedToStopError(Exception):
    """The worker ends: the work is for another one, or for its next start."""


class WorkLife:
    """Writes a claim's heartbeats in a thread of its own, with the bytes of the file so far.

    A failed heartbeat is retried; the last transaction checks the claim again.
    """

    def __init__(
        self, database: Database, work: Work, claim: uuid.UUID, every_seconds: float = BEAT_SECONDS
    ) -> None:
        self.bytes = 0
        self._database, self._work, self._claim, self._every = database, work, claim, every_seconds
        self._ending, self._lost = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._beat, name="work-life", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def check(self) -> None:
        """Raise ClaimLostError once a heartbeat has found the claim lost."""
        if self._lost.is_set():
            raise ClaimLostError

    def _beat(self) -> None:
        while not self._ending.wait(self._every):
            try:
                with self._database.write() as session:
                    is_ours = file_work.beat(
                        session, self._work, self._claim, Progress(0, self.bytes)
                    )
            except SQLAlchemyError as error:
                log.warning("work_beat_failed", error=type(error).__name__)
                continue
            if not is_ours:
                self._lost.set()
                return


@dataclass(frozen=True, slots=True)
class SealedFile:
    """A file in the store. length: in bytes."""

    key: str
    length: int
    sha256: str


class Attempt(Generic[OneWork]):
    """One attempt to make the files of an export or a release: staged, sealed, then named by the last transaction.

    Sealed blobs are removed at the end unless rows name them. They are kept if the last transaction raised, since it
    may have been committed; otherwise they are removed as orphans.
    """

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        settings: Settings,
        work: OneWork,
        claim: uuid.UUID,
        life: WorkLife,
        stopping: threading.Event,
    ) -> None:
        self.database, self.blobs, self.work = database, blobs, work
        self._life, self._claim, self._stopping = life, claim, stopping
        self._tasks = FileTasks(
            database, blobs.staging_folder(), settings.export_min_free_bytes, niceness=NICENESS
        )
        self._keys: list[str] = []
        self._is_named = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._is_named:
            for key in self._keys:
                self.blobs.delete(key)

    @contextmanager
    def folder(self) -> Iterator[Path]:
        """A new folder beside the store's files; it is removed at the end."""
        staging = self.blobs.staging_folder()
        with tempfile.TemporaryDirectory(prefix="made-", dir=staging) as folder:
            yield Path(folder)

    def run(
        self, task: str, request: Mapping[str, JsonValue], folder: Path
    ) -> dict[str, JsonValue]:
        """Run a task that writes into the folder. Raises ClaimLostError, AskedToStopError, and as FileTasks."""

        def watch() -> None:
            if self._stopping.is_set():
                raise AskedToStopError
            self._life.check()
            self._life.bytes = sum(path.stat().st_size for path in folder.iterdir())

        return self._tasks.run(task, request, most_seconds=MOST_SECONDS, watch=watch)

    def seal(self, path: Path, *names: str) -> SealedFile:
        """Move a file into the store, under a key that differs for every attempt."""
        length = path.stat().st_size
        sha256 = sha256_of_file(path)
        work = self.work
        parts = (MADE_FILES, f"{work.__tablename__}s", str(work.study_id), str(work.id))
        key = "/".join((*parts, self._claim.hex, *names, sha256))
        self.blobs.put_file(key, path)
        self._keys.append(key)
        return SealedFile(key, length, sha256)

    def finish(
        self, is_unchanged: Callable[[Session], bool], end: Callable[[Session, OneWork], None]
    ) -> bool:
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
