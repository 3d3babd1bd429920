"""Prepare a deployment: migrate the schema, load the starter food table, reapply erasures undone by a restore.

Safe to run by several processes concurrently, and repeatedly.
"""

import time
from collections.abc import Callable

import structlog

import app.tables  # noqa: F401  # defines every table
from app.children.faults import is_passing
from app.core.settings import Settings
from app.db.schema_state import is_current
from app.db.session import Database
from app.foods.import_foods import load_starter
from app.people.access.secret_box import existing_secret_box, keep_key, open_secret_box
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import ErasureLedger
from app.privacy.reapply_erasures import reapply_erasures
from app.storage.opening import open_blob_store

log = structlog.get_logger()

PATIENCE_SECONDS = 30.0  # covers a restart of the database with recovery
FIRST_WAIT_SECONDS = 0.2
LONGEST_WAIT_SECONDS = 2.0


def prepare_patiently(
    database: Database,
    settings: Settings,
    patience_seconds: float = PATIENCE_SECONDS,
    *,
    first: Callable[[Database, Settings], None] | None = None,
) -> None:
    """Prepare like `prepare`, but wait for a database and a store that start a little later than this process.

    Exiting and being restarted would cost seconds of a core per attempt, while other processes
    restart too. first: called before, at each attempt (prepare_apart.py). Raises the last error of
    `prepare` when the patience is over or if waiting does not help.
    """
    deadline, wait = time.monotonic() + patience_seconds, FIRST_WAIT_SECONDS
    while True:
        try:
            if first is not None:
                first(database, settings)
            prepare(database, settings)
        except Exception as error:
            if not is_passing(error) or time.monotonic() + wait > deadline:
                raise
            log.warning(
                "not_ready_to_start", reason=" ".join(str(error).split()), again_in_seconds=wait
            )
            time.sleep(wait)
            wait = min(2 * wait, LONGEST_WAIT_SECONDS)
        else:
            return


def prepare(database: Database, settings: Settings) -> None:
    """Bring everything up to date; existing data do not change."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    upgrade_schema(database)
    load_starter(database)
    _reapply_erasures(database, settings)
    if (box := existing_secret_box(settings)) is not None:
        keep_key(database, box)


def upgrade_schema(database: Database) -> None:
    """Migrate to the schema of this program. Raises what app.db.migrate.upgrade raises."""
    if not is_current(database):
        from app.db.migrate import upgrade  # noqa: PLC0415  # Alembic permanently takes 10 MB

        upgrade(database)


def _reapply_erasures(database: Database, settings: Settings) -> None:
    """Erase everything in the ledger of erasures that a restore has brought back."""
    store = open_blob_store(settings.resolved_erasure_url, settings)
    if next(store.keys(), None) is None:
        return
    box = open_secret_box(settings)
    eraser = Eraser(database, box, ErasureLedger(store, box))
    reapply_erasures(eraser, open_blob_store(settings.resolved_blob_url, settings))
