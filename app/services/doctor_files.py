"""What `tada doctor` says of what is made of the data: exports, releases, the sums of days."""

from collections.abc import Iterator
from itertools import islice

from app.db.queries import releases
from app.db.queries.figures import Figures, figures
from app.db.queries.releases import StuckRelease
from app.db.session import Database
from app.services.finding import Finding
from app.storage.blob_store import BlobStore

FILES_TOO_LONG_SECONDS = 3600  # as the alert TadaFilesLate
MANY_MARKS = 10_000  # as the alert TadaDaysMarked
LISTED = 5  # names told of a longer list
PUT_BACK = 'Put them back from a backup (docs/exports.md, "A lost file").'


def look_at_files(database: Database) -> Iterator[Finding]:
    """Changes nothing."""
    with database.read() as session:
        found = figures(session)
        stuck = releases.stuck_releases(session, LISTED)
    yield _waiting(found)
    if found.releases_stuck:
        yield _stuck(found.releases_stuck, stuck)
    yield _marks(found)


def look_at_release_files(database: Database, blobs: BlobStore) -> Iterator[Finding]:
    """Whether they are in the store, so that it is known before an erasure must change them."""
    subject = "files of releases"
    with database.read() as session:
        keys = releases.blob_keys(session)
    lost = [key for key in keys if not blobs.has(key)]
    if not lost:
        yield Finding(subject, "ok", f"all {len(keys)} are in the store")
        return
    listed = ", ".join(islice(lost, LISTED)) + (" ..." if len(lost) > LISTED else "")
    yield Finding(subject, "bad", f"{len(lost)} of {len(keys)} missing: {listed}.", PUT_BACK)


def _waiting(found: Figures) -> Finding:
    subject = "exports and releases"
    oldest = min((files.oldest_at for files in found.files.values() if files.oldest_at is not None), default=None)
    if oldest is None:
        return Finding(subject, "ok", "none waits")
    waited = (found.now - oldest).total_seconds()
    listed = ", ".join(
        f"{count} {kind}s {state}"
        for kind, files in sorted(found.files.items())
        for state, count in files.states.items()
        if count
    )
    said = f"{listed}; the oldest has waited {waited:.0f} s"
    if waited < FILES_TOO_LONG_SECONDS:
        return Finding(subject, "ok", said)
    advice = "A worker makes them, one at a time: see that one lives, and look for `file_not_made` in its log."
    return Finding(subject, "bad", f"{said}.", advice)


def _stuck(count: int, first: list[StuckRelease]) -> Finding:
    listed = ", ".join(f"{one.study_code} {one.name} ({one.failure_code})" for one in first)
    return Finding(
        "releases that must change",
        "bad",
        f"{count} cannot be written without what was erased, and are not served: {listed}"
        f"{' ...' if count > len(first) else ''}.",
        f"`tada releases check` names lost files. {PUT_BACK}",
    )


def _marks(found: Figures) -> Finding:
    subject, count = "sums of days", sum(found.marked_days.values())
    said = f"{count} changes are not summed yet"
    if count < MANY_MARKS:
        return Finding(subject, "ok", said)
    advice = "Figures are right meanwhile, and slow: a worker sums them; after an upgrade that takes a while."
    return Finding(subject, "note", f"{said}.", advice)
