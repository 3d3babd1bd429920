"""`tada doctor`: what is wrong with a deployment, in sentences; with `requeue`, meals that nothing moves are queued.

Each part is looked at by itself, so that one that is out of order hides no other: doctor_settings.py,
doctor_database.py, doctor_store.py, doctor_work.py, doctor_files.py.
"""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import sqlalchemy as sa
import sqlalchemy.exc
import structlog

from app.db.session import Database
from app.errors import TadaError
from app.services import doctor_database, doctor_files, doctor_store, doctor_work
from app.services.doctor_settings import look_at_settings
from app.services.finding import Finding
from app.services.secret_box import KEY_FILE, SecretBox, open_secret_box
from app.settings import Settings

__all__ = ["Finding", "examine"]

log = structlog.get_logger()


def examine(database: Database, settings: Settings, *, requeue: bool) -> list[Finding]:
    """Look at every part. Changes nothing unless `requeue`; a part that cannot be asked is a finding too."""
    return list(_examine(database, settings, requeue=requeue))


def _examine(database: Database, settings: Settings, *, requeue: bool) -> Iterator[Finding]:
    yield from look_at_settings(settings)
    is_usable = False
    for finding in _database(database):
        yield finding
        is_usable = (finding.level != "bad" and finding.subject == "schema") or is_usable
    blobs, finding = doctor_store.open_store(settings)
    yield finding
    if blobs is not None:
        yield from _asked("blob store", lambda: doctor_store.look_at_store(blobs, settings))
    if not is_usable:
        return
    workers = doctor_work.count_workers(database)
    alive = workers.total()
    yield from _asked("database", lambda: doctor_database.look_at_database(database, workers_alive=alive))
    yield from _asked("work", lambda: doctor_work.look_at_work(database, workers, requeue=requeue))
    yield from _asked("exports and releases", lambda: doctor_files.look_at_files(database))
    if blobs is not None:
        yield from _asked("photographs", lambda: doctor_store.look_at_photographs(database, blobs))
        yield from _asked("files of releases", lambda: doctor_files.look_at_release_files(database, blobs))
    yield from _asked("ledger of erasures", lambda: doctor_store.look_at_ledger(database, settings))
    yield from _asked("webhooks", lambda: doctor_work.look_at_webhooks(database, _box(settings)))
    yield from _asked("backup", lambda: [doctor_work.look_at_backup(database)])
    yield from _asked("index", lambda: [doctor_work.look_at_index(database)])


def _database(database: Database) -> Iterator[Finding]:
    if database.is_sqlite:
        path = Path(sa.make_url(database.url).database or "")
        if not path.is_file() or not path.stat().st_size:  # to look must not make it
            advice = "Run `tada db upgrade`, or set TADA_DATA_DIR or TADA_DATABASE_URL to where it is."
            yield Finding("database", "bad", f"there is none at {path.absolute()}.", advice)
            return
    found = doctor_database.look_at_connection(database)
    yield found
    if found.is_ok:
        yield from _asked("schema", lambda: doctor_database.look_at_schema(database))


def _asked(subject: str, look: Callable[[], Iterable[Finding]]) -> Iterator[Finding]:
    """A part's findings; if it cannot be asked, that."""
    try:
        yield from look()
    except (sqlalchemy.exc.SQLAlchemyError, TadaError, OSError) as error:
        log.warning("doctor_could_not_ask", subject=subject, exc_info=error)
        yield Finding(subject, "bad", f"it could not be asked ({type(error).__name__}).", "The log tells more.")


def _box(settings: Settings) -> SecretBox | None:
    if settings.secret_key is None and not (settings.data_dir / KEY_FILE).exists():
        return None
    return open_secret_box(settings)
