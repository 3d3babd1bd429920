"""`tada doctor`: what is wrong with a deployment, in sentences; with `requeue`, meals that nothing moves are queued."""

from collections.abc import Iterator
from dataclasses import dataclass

from app.db.queries import jobs, meals, vectors
from app.db.session import Database
from app.errors import TadaError
from app.jobs.engine import JobQueue
from app.jobs.sweep import sweep
from app.services.health import check_readiness
from app.services.project_records import project_meal
from app.settings import Settings
from app.storage.blob_store import BlobStore
from app.storage.opening import open_blob_store
from app.vision.vcm import VCM_VERSION

WAITING_TOO_LONG_SECONDS = 600
LISTED = 5  # names told of a longer list


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    subject: str
    is_ok: bool
    message: str


def examine(database: Database, settings: Settings, *, requeue: bool) -> list[Finding]:
    """Look at every part. Changes nothing unless `requeue`."""
    try:
        blobs = open_blob_store(settings.resolved_blob_url, settings)
    except (TadaError, OSError) as error:
        return [Finding("blob store", is_ok=False, message=f"{settings.resolved_blob_url}: {error}")]
    return [
        *_parts(database, blobs, settings),
        *_stranded(database, requeue=requeue),
        _photos(database, blobs),
        _vectors(database),
    ]


def _parts(database: Database, blobs: BlobStore, settings: Settings) -> Iterator[Finding]:
    ready = check_readiness(database, blobs, settings)
    for subject, state in ready.checks.items():
        yield Finding(subject.replace("_", " "), is_ok=state == "ok", message=state)
    alive = ready.workers_alive
    yield Finding("workers", is_ok=alive > 0, message=f"{alive} alive" if alive else "none: start `tada worker`")
    waited = ready.oldest_waiting_seconds or 0.0
    yield Finding(
        "queue",
        is_ok=waited < WAITING_TOO_LONG_SECONDS,
        message=f"the oldest waiting meal has waited {waited:.0f} s" if waited else "no meal waits",
    )


def _stranded(database: Database, *, requeue: bool) -> Iterator[Finding]:
    with database.read() as session:
        found = len(jobs.stuck_jobs(session)) + len(jobs.waiting_without_live_job(session))
    message = f"{found} that nothing will move"
    if found and requeue:
        queue = JobQueue(database)
        try:
            message += f", {sweep(database, queue, project_meal)} moved (see the log)"
        finally:
            queue.close()
    elif found:
        message += ": queue them again with `tada doctor --requeue`"
    yield Finding("meals", is_ok=not found or requeue, message=message)


def _photos(database: Database, blobs: BlobStore) -> Finding:
    """Whether every photograph that the database names is in the store."""
    missing, total = [], 0
    with database.read() as session:
        for key in meals.blob_keys(session):
            total += 1
            if not blobs.has(key):
                missing.append(key)
    if missing:
        listed = ", ".join(missing[:LISTED]) + (" ..." if len(missing) > LISTED else "")
        return Finding("photographs", is_ok=False, message=f"{len(missing)} of {total} missing: {listed}")
    return Finding("photographs", is_ok=True, message=f"all {total} are in the store")


def _vectors(database: Database) -> Finding:
    """Whether the index learns from all that was confirmed: told, and no fault, as after an upgrade."""
    with database.read() as session:
        count = vectors.confirmed_without_vector(session, VCM_VERSION)
    message = f"{count} confirmed items have no vector of version {VCM_VERSION}"
    return Finding("index", is_ok=True, message=f"{message}: `tada index rebuild`" if count else message)
