"""What a worker does beside estimating meals; jobs/chores.py says when."""

from app.db.session import Database
from app.jobs.chores import Chore
from app.services.deliver_webhooks import DeliverWebhooks
from app.services.secret_box import SecretBox
from app.services.webhook_post import WebhookPost
from app.settings import Settings
from app.storage.blob_store import BlobStore


def worker_chores(database: Database, blobs: BlobStore, box: SecretBox, settings: Settings) -> list[Chore]:
    """The chores of one worker."""
    del blobs
    deliver = DeliverWebhooks(database, box, WebhookPost(allow_loopback=settings.webhook_allow_loopback))
    return [
        Chore("deliver_webhooks", 1.0, deliver.run),
        Chore("tidy_webhooks", 60.0, deliver.tidy),
    ]
