"""Checks of processing: workers, queue, failures; exports and releases; webhooks, backup, index."""

from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta

from app import __version__
from app.candidates import queries as vectors
from app.exports.releases import queries as releases
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue, sweep
from app.metrics.instruments import SERVER_FAILURES
from app.operations import queries as doctor
from app.operations.doctor.finding import LISTED, Deployment, Verdict, bad, note, ok
from app.operations.queries import first_event_at, last_backup
from app.people.access.secret_box import SecretKeyError
from app.records.project_records import project_meal
from app.vision.looks.vcm import VCM_VERSION
from app.webhooks.webhook_signature import open_secrets

WAITING_TOO_LONG_SECONDS = 600
LATELY = timedelta(days=7)
TRIES_OF_A_FAILING_RECEIVER = 3  # half an hour of it
BACKUP_EVERY = timedelta(days=2)
FILES_TOO_LONG_SECONDS = 3600  # as the alert TadaFilesLate


def look_at_workers(deployment: Deployment) -> Verdict:
    """Check that workers of this version are running."""
    workers = Counter(deployment.worker_versions)
    listed = ", ".join(
        f"{count} of version {version}" for version, count in sorted(workers.items())
    )
    if not workers:
        return bad("none: meals are stored but not estimated.", "Start `tada worker`.")
    if set(workers) != {__version__}:
        advice = "Finish the upgrade: they should all be of one version."
        return note(f"alive: {listed}; this program is {__version__}.", advice)
    return ok(f"alive: {listed}")


def look_at_queue(deployment: Deployment) -> Verdict:
    """Check that no meal waits too long."""
    figures = deployment.figures
    if figures.oldest_queued_at is None:
        return ok("no meal waits")
    waited = (figures.now - figures.oldest_queued_at).total_seconds()
    queue = f"{figures.jobs['queued']} jobs of {figures.studies_waiting} studies, the oldest has waited {waited:.0f} s"
    if waited < WAITING_TOO_LONG_SECONDS:
        return ok(queue)
    with deployment.database.read() as session:
        faulty = jobs.count_faulty(session)
    if faulty:
        return bad(
            f"{queue}; {faulty} wait for a fault to pass.",
            "The worker's log names it (job_step_failed).",
        )
    return bad(f"{queue}.", "Start more workers (docs/jobs.md), or look at their log.")


def look_at_stranded_meals(deployment: Deployment) -> Verdict:
    """Check that each waiting meal has a job; with `requeue`, queue those without one again."""
    with deployment.database.read() as session:
        count = len(jobs.exhausted_jobs(session)) + len(jobs.waiting_without_live_job(session))
    if not count:
        return ok("no meal is stuck")
    message = f"{count} are stuck"
    if not deployment.requeue:
        return bad(f"{message}.", "Queue them again with `tada doctor --requeue`.")
    return ok(
        f"{message}, {sweep(deployment.database, JobQueue(), project_meal)} queued again or failed (see the log)"
    )


def look_at_failures(deployment: Deployment) -> Verdict:
    """Check that no meal failed recently because of the server."""
    with deployment.database.read() as session:
        failures = doctor.failures_since(session, datetime.now(UTC) - LATELY)
    ours = {code: count for code, count in failures.items() if code in SERVER_FAILURES}
    if ours:
        advice = "The log tells why; photographs are kept: `tada jobs retry` estimates them again (docs/jobs.md)."
        return bad(f"because of the server, in 7 days: {_by_count(ours)}.", advice)
    return ok(
        f"in 7 days, because of the photographs: {_by_count(failures)}"
        if failures
        else "none in 7 days"
    )


def look_at_files(deployment: Deployment) -> Verdict:
    """Check that no export or release waits too long."""
    figures = deployment.figures
    oldest = min(
        (files.oldest_at for files in figures.files.values() if files.oldest_at is not None),
        default=None,
    )
    if oldest is None:
        return ok("none waits")
    waited = (figures.now - oldest).total_seconds()
    listed = ", ".join(
        f"{count} {kind}s {state}"
        for kind, files in sorted(figures.files.items())
        for state, count in files.states.items()
        if count
    )
    message = f"{listed}; the oldest has waited {waited:.0f} s"
    if waited < FILES_TOO_LONG_SECONDS:
        return ok(message)
    advice = "A worker creates them, one at a time: check that one is running, and look for `file_not_made` in its log."
    return bad(f"{message}.", advice)


def look_at_stuck_releases(deployment: Deployment) -> Verdict | None:
    """Check that all releases could be rewritten without erased data."""
    count = deployment.figures.releases_stuck
    if not count:
        return None
    with deployment.database.read() as session:
        first = releases.stuck_releases(session, LISTED)
    listed = ", ".join(f"{stuck.study_code} {stuck.name} ({stuck.failure_code})" for stuck in first)
    return bad(
        f"{count} cannot be rewritten without erased data, and are not served: {listed}"
        f"{' ...' if count > len(first) else ''}.",
        '`tada releases check` names lost files. Put them back from a backup (docs/exports.md, "A lost file").',
    )


def look_at_webhook_secrets(deployment: Deployment) -> Verdict | None:
    """Check that the newest webhook's secret can be opened."""
    with deployment.database.read() as session:
        sealed = doctor.a_sealed_secret(session)
    if sealed is not None and deployment.box is not None:
        try:
            open_secrets(deployment.box, sealed)
        except SecretKeyError as error:
            return bad(error.message, "Set TADA_SECRET_KEY to the original key.")
    return None


def look_at_webhooks(deployment: Deployment) -> Verdict:
    """Check that receivers accept deliveries."""
    figures = deployment.figures
    with deployment.database.read() as session:
        failing = doctor.failing_deliveries(session, TRIES_OF_A_FAILING_RECEIVER)
    if failing:
        return bad(
            f"{failing} deliveries failed {TRIES_OF_A_FAILING_RECEIVER} times or more and wait for the next attempt.",
            "Ask those who run the receivers; each webhook's deliveries show the responses (docs/webhooks.md).",
        )
    if figures.webhooks_disabled:
        message = (
            f"{figures.webhooks_disabled} are disabled, by their owners or after failures in a row."
        )
        return note(message, "Their owners enable them again by PATCH.")
    return ok(f"{figures.deliveries_waiting} deliveries wait")


def look_at_backup(deployment: Deployment) -> Verdict:
    """Check the last `tada backup`; other kinds of backup are not known here."""
    with deployment.database.read() as session:
        last, began_at = last_backup(session), first_event_at(session)
    now = datetime.now(UTC)
    if last is None:
        advice = "Run `tada backup` daily, or monitor the backups that you make by other means (docs/backup.md)."
        message = "no `tada backup` of this database is known"
        if began_at is not None and now - began_at > BACKUP_EVERY:
            hours = (now - began_at).total_seconds() / 3600
            return bad(f"{message}, and it has been in use for {hours:.0f} h.", advice)
        return note(f"{message}.", advice)
    age = now - last.made_at
    message = f"the last `tada backup` is {age.total_seconds() / 3600:.0f} h old"
    if last.damaged:
        return bad(
            f"{message}, and lacks {last.damaged} blobs that were damaged or missing.",
            'Put them back from an earlier backup, then make another (docs/backup.md, "Missing blobs").',
        )
    if age > BACKUP_EVERY:
        return bad(f"{message}.", "Make one now, and find out why the daily one failed.")
    if last.piped:
        message = f"{message}, and was sent to a pipe: whether it was stored is not known here."
        return note(message, "Check the file with `tada restore --check` (docs/backup.md).")
    return ok(message)


def look_at_index(deployment: Deployment) -> Verdict:
    """Report confirmed items that the index does not learn from, which is normal after an upgrade."""
    with deployment.database.read() as session:
        count = vectors.confirmed_without_vector(session, VCM_VERSION)
    message = f"{count} confirmed items have no vector of version {VCM_VERSION}"
    return ok(f"{message}: `tada index rebuild`" if count else message)


def _by_count(counts: Mapping[str, int]) -> str:
    return ", ".join(
        f"{code} {count}"
        for code, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    )
