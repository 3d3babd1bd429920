"""What a worker does beside estimating meals; jobs/chores.py says when."""

from app.db.session import Database
from app.jobs.chores import Chore
from app.services.secret_box import SecretBox
from app.settings import Settings
from app.storage.blob_store import BlobStore


def worker_chores(database: Database, blobs: BlobStore, box: SecretBox, settings: Settings) -> list[Chore]:
    """The chores of one worker."""
    del database, blobs, box, settings
    return []
