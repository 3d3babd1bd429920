"""What `tada doctor` says of the work: workers, the queue, meals that nobody will move, what failed and why.

Exports, releases and sums of days are told by doctor_files.py.
"""

from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from app import __version__
from app.db.queries import doctor, jobs, vectors
from app.db.queries.figures import figures, first_event_at, last_backup
from app.db.session import Database
from app.jobs.leases import living_workers
from app.jobs.queue import JobQueue
from app.jobs.sweep import sweep
from app.metrics.instruments import SERVER_FAILURES
from app.services.finding import Finding
from app.services.project_records import project_meal
from app.services.secret_box import SecretBox, SecretKeyError
from app.services.webhook_signature import open_secrets
from app.vision.looks.vcm import VCM_VERSION

WAITING_TOO_LONG_SECONDS = 600
LATELY = timedelta(days=7)
TRIES_OF_A_FAILING_RECEIVER = 3  # half an hour of it
BACKUP_EVERY = timedelta(days=2)


def count_workers(database: Database) -> Counter[str]:
    """Version -> how many live."""
    return Counter(worker.version for worker in living_workers(database))


def look_at_work(database: Database, workers: Counter[str], *, requeue: bool) -> Iterator[Finding]:
    """Changes nothing unless `requeue`."""
    yield _workers(workers)
    yield _queue(database)
    yield _stranded(database, requeue=requeue)
    yield _failures(database)


def _workers(workers: Counter[str]) -> Finding:
    listed = ", ".join(f"{count} of version {version}" for version, count in sorted(workers.items()))
    if not workers:
        return Finding("workers", "bad", "none: meals are kept, and none is estimated.", "Start `tada worker`.")
    if set(workers) != {__version__}:
        advice = "Finish the upgrade: they should all be of one version."
        return Finding("workers", "note", f"alive: {listed}; this program is {__version__}.", advice)
    return Finding("workers", "ok", f"alive: {listed}")


def _queue(database: Database) -> Finding:
    with database.read() as session:
        found = figures(session)
    oldest = found.oldest_queued_at
    if oldest is None:
        return Finding("queue", "ok", "no meal waits")
    waited = (found.now - oldest).total_seconds()
    said = f"{found.jobs['queued']} jobs of {found.studies_waiting} studies, the oldest has waited {waited:.0f} s"
    if waited < WAITING_TOO_LONG_SECONDS:
        return Finding("queue", "ok", said)
    return Finding("queue", "bad", f"{said}.", "Start more workers (docs/jobs.md), or look at their log.")


def _stranded(database: Database, *, requeue: bool) -> Finding:
    with database.read() as session:
        found = len(jobs.exhausted_jobs(session)) + len(jobs.waiting_without_live_job(session))
    if not found:
        return Finding("meals", "ok", "none waits for what will never come")
    message = f"{found} that nothing will move"
    if not requeue:
        return Finding("meals", "bad", f"{message}.", "Queue them again with `tada doctor --requeue`.")
    return Finding("meals", "ok", f"{message}, {sweep(database, JobQueue(), project_meal)} moved (see the log)")


def _failures(database: Database) -> Finding:
    with database.read() as session:
        found = doctor.failures_since(session, datetime.now(UTC) - LATELY)
    ours = {code: count for code, count in found.items() if code in SERVER_FAILURES}
    if ours:
        advice = "The log tells why; photographs are kept: `tada jobs retry` estimates them again (docs/jobs.md)."
        return Finding("failed meals", "bad", f"by the server's fault, in 7 days: {_by_count(ours)}.", advice)
    if found:
        return Finding("failed meals", "ok", f"in 7 days, by the photographs: {_by_count(found)}")
    return Finding("failed meals", "ok", "none in 7 days")


def look_at_webhooks(database: Database, box: SecretBox | None) -> Iterator[Finding]:
    """box: None where there is no secret key yet, and so nothing sealed."""
    with database.read() as session:
        found = figures(session)
        failing = doctor.failing_deliveries(session, TRIES_OF_A_FAILING_RECEIVER)
        sealed = doctor.a_sealed_secret(session)
    if sealed is not None and box is not None:
        try:
            open_secrets(box, sealed)
        except SecretKeyError as error:
            yield Finding("webhooks' secrets", "bad", error.message, "Give the key of then in TADA_SECRET_KEY.")
    if failing:
        yield Finding(
            "webhooks",
            "bad",
            f"{failing} deliveries failed {TRIES_OF_A_FAILING_RECEIVER} times or more and wait for the next try.",
            "Ask those who run the receivers; each webhook's deliveries tell what they answered (docs/webhooks.md).",
        )
    elif found.webhooks_disabled:
        message = f"{found.webhooks_disabled} are disabled, by their owners or after failures in a row."
        yield Finding("webhooks", "note", message, "Their owners enable them again by PATCH.")
    else:
        yield Finding("webhooks", "ok", f"{found.deliveries_waiting} deliveries wait")


def look_at_backup(database: Database) -> Finding:
    """Of `tada backup` only: other means are not known here."""
    with database.read() as session:
        found, began_at = last_backup(session), first_event_at(session)
    now = datetime.now(UTC)
    if found is None:
        advice = "Run `tada backup` daily, or watch over the backups that you make by other means (docs/backup.md)."
        said = "no `tada backup` of this database is known"
        if began_at is not None and now - began_at > BACKUP_EVERY:
            hours = (now - began_at).total_seconds() / 3600
            return Finding("backup", "bad", f"{said}, and it has been in use for {hours:.0f} h.", advice)
        return Finding("backup", "note", f"{said}.", advice)
    age = now - found.made_at
    said = f"the last `tada backup` is {age.total_seconds() / 3600:.0f} h old"
    if found.damaged:
        message = f"{said}, and lacks {found.damaged} blobs that were damaged or missing."
        advice = 'Put them back from an earlier backup, then make another (docs/backup.md, "Missing blobs").'
        return Finding("backup", "bad", message, advice)
    if age > BACKUP_EVERY:
        return Finding("backup", "bad", f"{said}.", "Make one now, and see why the daily one was not made.")
    if found.piped:
        message = f"{said}, and was sent to a pipe: whether it was kept is not known here."
        return Finding("backup", "note", message, "Check the file with `tada restore --check` (docs/backup.md).")
    return Finding("backup", "ok", said)


def look_at_index(database: Database) -> Finding:
    """Whether the index learns from all that was confirmed: told, and no fault, as after an upgrade."""
    with database.read() as session:
        count = vectors.confirmed_without_vector(session, VCM_VERSION)
    message = f"{count} confirmed items have no vector of version {VCM_VERSION}"
    return Finding("index", "ok", f"{message}: `tada index rebuild`" if count else message)


def _by_count(counts: dict[str, int]) -> str:
    return ", ".join(f"{code} {count}" for code, count in sorted(counts.items(), key=lambda one: (-one[1], one[0])))
