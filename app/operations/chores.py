"""The chores of a worker beside estimates; jobs/chores.py schedules them."""

from datetime import UTC, datetime, timedelta
from functools import partial

from app.core.settings import Settings
from app.db.session import Database
from app.exports.releases.file_work_chore import FileThread, expire_exports
from app.jobs.chores import Chore
from app.meals.upload.after_meal import end_due_windows
from app.operations.trusted_clock import TrustedClock
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import forget_attempts
from app.privacy.delete_blobs import BUCKET, FILES, BlobDeleter, OrphanRounds
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import ErasureLedger
from app.privacy.reapply_erasures import reapply_erasures
from app.privacy.retention import erase_old_pictures, erase_sandboxes
from app.storage.blob_store import BlobStore
from app.storage.opening import open_blob_store
from app.webhooks.deliver_webhooks import DeliverWebhooks
from app.webhooks.webhook_post import WebhookPost

HOUR = 3600.0
UNDER_WAY = timedelta(minutes=10)  # a more recent erasure is still being carried out by the request


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
