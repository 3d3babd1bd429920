"""The worker's chores for exports and releases: a thread that makes them, and the end of exports."""

import threading
import uuid
from datetime import UTC, datetime, timedelta

import structlog

from app.core.settings import Settings
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.exports.releases.file_runner import FileRunner
from app.metrics import instruments
from app.people.access.secret_box import SecretBox
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

BATCH = 200
LISTED_FOR = timedelta(days=30)  # exports without a file, after their end


class FileThread:
    """At most one file at a time, made in a thread so that the other chores go on."""

    def __init__(
        self, database: Database, blobs: BlobStore, settings: Settings, box: SecretBox
    ) -> None:
        self._database, self._blobs, self._settings, self._box = database, blobs, settings, box
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def look(self) -> None:
        """Start a file if there is work and none is being made. Returns at once."""
        if self._thread is not None and self._thread.is_alive():
            return
        with self._database.read() as session:
            if not file_work.has_work(session):
                return
        self._thread = threading.Thread(target=self._make, name="file", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the file under way; its work is given back."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def _make(self) -> None:
        runner = FileRunner(
            self._database,
            self._blobs,
            self._settings,
            self._box,
            uuid.uuid4(),
            stopping=self._stopping,
        )
        try:
            ended = runner.run_one()
        except Exception as error:  # the thread's edge: the claim's lease ends
            log.warning("file_work_failed", exc_info=error)
            return
        if ended is not None:
            outcome = instruments.outcome_label(ended.outcome)
            instruments.FILES_MADE.labels(ended.kind, outcome).inc()


def expire_exports(database: Database, now: datetime | None = None) -> int:
    """Expire exports whose time is over, and delete old rows without a file. Returns the number of expired exports."""
    now, total = now or datetime.now(UTC), 0
    while True:
        with database.write() as session:
            count = exports.expire_due(session, now, BATCH)
            exports.forget_ended(session, now - LISTED_FOR)
        total += count
        if count < BATCH:
            return total
