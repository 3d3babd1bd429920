"""Make a deployment usable: schema, job tables, starter food table, erasures that a restore undid done again.

Safe to run by several processes at once, and again.
"""

from app.db.migrate import upgrade
from app.db.session import Database
from app.jobs.engine import prepare_job_tables
from app.services.erase import Eraser
from app.services.erasure_ledger import ErasureLedger
from app.services.import_foods import load_starter
from app.services.reapply_erasures import reapply_erasures
from app.services.secret_box import open_secret_box
from app.settings import Settings
from app.storage.opening import open_blob_store


def prepare(database: Database, settings: Settings) -> None:
    """Bring everything up to date; what is already there stays as it is."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    upgrade(database)
    prepare_job_tables(database)
    load_starter(database)
    _erase_what_a_restore_brought_back(database, settings)


def _erase_what_a_restore_brought_back(database: Database, settings: Settings) -> None:
    """Before anybody serves or works: what the ledger of erasures has must not be here."""
    store = open_blob_store(settings.resolved_erasure_url, settings)
    if next(store.keys(), None) is None:
        return
    box = open_secret_box(settings)
    eraser = Eraser(database, box, ErasureLedger(store, box))
    reapply_erasures(eraser, open_blob_store(settings.resolved_blob_url, settings))
