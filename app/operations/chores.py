"""The chores of a worker beside estimates; jobs/chores.py schedules them.

Retention erases by age, which cannot be undone, so it asks whether the clock can be trusted.
"""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import partial

import structlog
from sqlalchemy.orm import Session

from app.core.settings import Settings
from app.db.session import Database
from app.exports.releases.file_work_chore import FileThread, expire_exports
from app.jobs.chores import Chore
from app.meals.upload.after_meal import end_due_windows
from app.metrics import instruments
from app.operations.queries import database_now, last_event_at
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import forget_attempts
from app.people.privacy_queries import locked_deployment
from app.privacy.delete_blobs import BUCKET, FILES, BlobDeleter, OrphanRounds
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import ErasureLedger
from app.privacy.reapply_erasures import reapply_erasures
from app.privacy.retention import erase_old_pictures, erase_sandboxes
from app.storage.blob_store import BlobStore
from app.storage.opening import open_blob_store
from app.webhooks.deliver_webhooks import DeliverWebhooks
from app.webhooks.webhook_post import WebhookPost

log = structlog.get_logger()

GAP_SECONDS = 86400.0
WAIT_SECONDS = 86400.0
HOUR = 3600.0
UNDER_WAY = timedelta(minutes=10)  # a more recent erasure is still being carried out by the request


class TrustedClock:
    """The clock of the database; on SQLite this machine's.

    A row keeps the clock as a worker last saw it; before there is one, the newest event tells when
    somebody saw the clock. A clock that is over a day off, also after a pause, is doubted until the
    workers have run for a day or an operator says that it is right.

    running: seconds by a clock that nobody sets; for tests
    """

    def __init__(self, database: Database, running: Callable[[], float] = time.monotonic) -> None:
        self._database = database
        self._running = running
        self._last_tick: float | None = None

    def tick(self) -> datetime | None:
        """Compare the clock with the row, then write it there.

        Returns the time, None while it is doubted.
        """
        running = self._running()
        ran = 0.0 if self._last_tick is None else running - self._last_tick
        self._last_tick = running
        with self._database.write() as session:
            now = database_now(session)
            row = locked_deployment(session)
            seen_at = row.clock_at or last_event_at(session) or now
            gap = (now - seen_at).total_seconds()
            if abs(gap) > GAP_SECONDS:
                row.clock_doubted_seconds = WAIT_SECONDS
                log.error("clock_doubted", gap_seconds=round(gap), seen_at=seen_at.isoformat())
            else:
                row.clock_doubted_seconds = max(
                    0.0, row.clock_doubted_seconds - max(0.0, min(gap, ran))
                )
            row.clock_at = now
            is_doubted = row.clock_doubted_seconds > 0
        instruments.CLOCK_DOUBTED.set(is_doubted)
        return None if is_doubted else now


def trust_clock(session: Session) -> None:
    """Trust the clock as it is now."""
    row = locked_deployment(session)
    row.clock_at, row.clock_doubted_seconds = database_now(session), 0.0


def worker_chores(
    database: Database,
    blobs: BlobStore,
    box: SecretBox,
    settings: Settings,
    clock: TrustedClock | None = None,
) -> list[Chore]:
    """Return the chores of one worker, without its extras'. clock: for tests."""
    clock = clock or TrustedClock(database)
    deleter = BlobDeleter(database, blobs)
    is_bucket = settings.resolved_blob_url.startswith("s3://")
    orphans = OrphanRounds(database, deleter, BUCKET if is_bucket else FILES)
    ledger = ErasureLedger(open_blob_store(settings.resolved_erasure_url, settings), box)
    eraser = Eraser(database, box, ledger)

    def finish_erasures() -> int:
        return reapply_erasures(eraser, blobs, before=datetime.now(UTC) - UNDER_WAY)

    def apply_retention() -> int:
        if (now := clock.tick()) is None:
            return 0
        return erase_old_pictures(database, now) + erase_sandboxes(eraser, now)

    def tidy() -> None:
        deleter.tidy()
        forget_attempts(database)

    files = FileThread(database, blobs, settings, box)
    post = WebhookPost(allow_loopback=settings.webhook_allow_loopback)
    deliver = DeliverWebhooks(database, box, post)
    return [
        Chore("close_after_windows", 10.0, partial(end_due_windows, database)),
        Chore("delete_blobs", 5.0, deleter.delete_scheduled),
        Chore("finish_erasures", HOUR, finish_erasures),
        Chore("watch_clock", 60.0, clock.tick),
        Chore("erase_old_pictures", HOUR, apply_retention),
        Chore("delete_orphans", 30.0, orphans.run_slice),
        Chore("tidy", HOUR, tidy),
        Chore("deliver_webhooks", 1.0, deliver.run),
        Chore("give_up_deliveries", 60.0, deliver.give_up_unsendable),
        Chore("remove_old_deliveries", HOUR, deliver.remove_old),
        Chore("make_files", 1.0, files.look, at_end=files.stop),
        Chore("expire_exports", 60.0, lambda: expire_exports(database)),
    ]
