"""Check whether the server is ready for meals, with information for its operators.

Readiness depends only on database, blob store and disk. A long queue or a dead worker is reported, but meals are
accepted.
"""

from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa

from app.core.settings import Settings
from app.db.schema_state import SchemaState, schema_state
from app.db.session import Database
from app.jobs.leases import living_workers
from app.meals.stored import queries as meals
from app.storage.blob_store import BlobStore


@dataclass(frozen=True, slots=True)
class Readiness:
    """checks: name -> "ok" or the problem. The other fields are information."""

    checks: dict[str, str]
    workers_alive: int
    oldest_waiting_seconds: float | None

    @property
    def is_ready(self) -> bool:
        """Return whether all checks are ok."""
        return all(state == "ok" for state in self.checks.values())


def check_readiness(database: Database, blobs: BlobStore, settings: Settings) -> Readiness:
    """Check each part that an upload needs. Does not raise for a part that fails."""
    workers, oldest = 0, None
    try:
        if (
            schema_state(database) is not SchemaState.OLDER
        ):  # code works with a newer schema too (docs/deployment.md)
            state = "ok"
            workers = len(living_workers(database))
            with database.read() as session:
                oldest = meals.oldest_waiting(session)
        else:
            state = "the schema is not up to date: run `tada db upgrade`"
    except sa.exc.SQLAlchemyError as error:
        state = f"no answer ({type(error).__name__})"
    checks = {"database": state}
    try:
        blobs.check()
        free = blobs.free_bytes()
    except OSError as error:
        checks["blob_store"] = f"cannot be written ({error.strerror})"
    else:
        checks["blob_store"] = "ok"
        low = free < settings.min_free_bytes
        checks["disk"] = f"{free} bytes free, less than {settings.min_free_bytes}" if low else "ok"
    waited = (datetime.now(UTC) - oldest).total_seconds() if oldest is not None else None
    return Readiness(checks, workers, waited)
