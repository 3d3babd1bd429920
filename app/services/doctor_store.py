"""What `tada doctor` says of the blob store and the ledger of erasures: writable, whole, with room, in a good place."""

import hashlib
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from urllib.parse import unquote, urlsplit

import sqlalchemy as sa

from app.db.queries import doctor, meals, privacy
from app.db.session import Database
from app.errors import TadaError
from app.services.erasure_ledger import KINDS, ErasureLedger
from app.services.finding import Finding
from app.services.ledger_gaps import count_missing
from app.services.missing_blobs import find_missing
from app.services.secret_box import KEY_FILE, SecretKeyError, open_secret_box
from app.settings import Settings
from app.storage.blob_store import BlobStore
from app.storage.opening import open_blob_store

LISTED = 5  # names told of a longer list
READ_BACK = 20  # of the newest photographs
ROOMY = 4  # times TADA_MIN_FREE_BYTES
UNDER_WAY = timedelta(minutes=10)  # an erasure that was asked for just now is still being carried out
DELETED_WITHIN = timedelta(hours=1)  # what an erasure wants gone goes within seconds, while a worker lives
GIBIBYTE = 1024**3


def open_store(settings: Settings) -> tuple[BlobStore | None, Finding]:
    """The store, if it can be written."""
    try:
        blobs = open_blob_store(settings.resolved_blob_url, settings)
        blobs.check()
    except (TadaError, OSError) as error:
        words = error.message if isinstance(error, TadaError) else (error.strerror or str(error))
        return None, Finding(
            "blob store",
            "bad",
            f"it cannot be written: {words}.",
            "Mend it, or set TADA_BLOB_URL to where it is; uploads are refused until then, nothing is lost.",
        )
    return blobs, Finding("blob store", "ok", "written, and what was written removed")


def look_at_store(blobs: BlobStore, settings: Settings) -> Iterator[Finding]:
    """Room, and whether what is deleted is gone."""
    free, least = blobs.free_bytes(), settings.min_free_bytes
    said = f"{free / GIBIBYTE:.1f} GiB free where uploads are written; below {least / GIBIBYTE:.1f} they are refused"
    advice = "Make room, or move the data to a larger disk."
    if free < least:
        yield Finding("disk", "bad", f"{said}: no meal is accepted.", advice)
    elif free < ROOMY * least:
        yield Finding("disk", "note", f"{said}.", advice)
    else:
        yield Finding("disk", "ok", said)
    if getattr(blobs, "keeps_versions", None):
        yield Finding(
            "blob store's versions",
            "bad",
            "the bucket keeps what is deleted: a participant's erased photographs are still there.",
            "Add a lifecycle rule that removes noncurrent versions within days, or turn versioning off.",
        )


def look_at_photographs(database: Database, blobs: BlobStore) -> Iterator[Finding]:
    """Whether all that the database names are there, and whether the newest are what was sealed."""
    yield _photos(database, blobs)
    with database.read() as session:
        newest = doctor.newest_photographs(session, READ_BACK)
    damaged, unread = [], []
    for key, sha256 in newest:
        try:
            if _sha256_of(blobs, key) != sha256:
                damaged.append(key)
        except (TadaError, OSError):
            unread.append(key)
    if damaged or unread:
        yield Finding(
            "newest photographs",
            "bad",
            f"of {len(newest)} {len(damaged)} are not what was sealed, {len(unread)} cannot be read: "
            f"{_some(damaged + unread)}.",
            "Look at the disk or the bucket before anything else writes to it, then restore a backup.",
        )
    else:
        yield Finding("newest photographs", "ok", f"{len(newest)} read back, bit for bit")


def look_at_ledger(database: Database, settings: Settings) -> Iterator[Finding]:
    """Whether erasures can be noted, are all carried out, and would outlive a restore."""
    subject = "ledger of erasures"
    try:
        store = open_blob_store(settings.resolved_erasure_url, settings)
        store.check()
    except (TadaError, OSError) as error:
        words = error.message if isinstance(error, TadaError) else (error.strerror or str(error))
        advice = "Mend it, or set TADA_ERASURE_URL to where it is."
        yield Finding(subject, "bad", f"it cannot be written: {words}. Nobody can be erased.", advice)
        return
    yield _place_of_ledger(settings)
    if settings.secret_key is None and not (settings.data_dir / KEY_FILE).exists():
        return
    ledger = ErasureLedger(store, open_secret_box(settings))
    missing = count_missing(database, ledger)
    if missing:
        yield Finding(
            "ledger's entries",
            "note",
            f"{missing} erasures that the database remembers are not there: it is not the ledger of then.",
            "Copy the old ledger's entries into it, or a restored backup brings back whom they erased.",
        )
    yield _open_erasures(database, ledger)


def _place_of_ledger(settings: Settings) -> Finding:
    """A backup without its ledger brings back whom the ledger erased: what loses the data must not lose both."""
    subject, ledger = "ledger of erasures", settings.resolved_erasure_url
    elsewhere = "Set TADA_ERASURE_URL to another disk, machine or bucket, and move its entries there."
    folder = _folder_of(ledger)
    if folder is not None and folder.is_relative_to(settings.data_dir.resolve()):
        return Finding(
            subject,
            "note",
            "it lies in TADA_DATA_DIR: whoever restores that folder brings it back as it was, and erased people too.",
            "Set TADA_ERASURE_URL to another place, or leave the folder out of backups of files.",
        )
    blobs = settings.resolved_blob_url
    if folder is None and _bucket_of(ledger) == _bucket_of(blobs):
        message = "it lies in the photographs' bucket: whatever takes the bucket takes both."
        return Finding(subject, "note", message, elsewhere)
    files = [place for place in (_folder_of(blobs), _sqlite_file(settings)) if place is not None]
    if folder is not None and any(disk_of(folder) == disk_of(place) for place in files):
        message = "it lies on the disk of the photographs or of the database: a disk that dies takes both."
        return Finding(subject, "note", message, elsewhere)
    return Finding(subject, "ok", "written, and apart from what it is to outlive")


def disk_of(path: Path) -> int:
    """Which file system a path is on, or is going to be."""
    return next(one for one in (path, *path.parents) if one.exists()).stat().st_dev


def _open_erasures(database: Database, ledger: ErasureLedger) -> Finding:
    subject, advice = "erasures", "A worker carries them out within the hour: start one, and look at its log."
    before, left = datetime.now(UTC) - UNDER_WAY, 0
    for kind in KINDS:
        noted = set(ledger.digests(kind, before))
        with database.read() as session:
            unfinished = noted - privacy.tombstones_among(session, kind, noted)
        left += len(unfinished)
        try:
            for digest in sorted(unfinished)[:1]:
                ledger.read(kind, digest)
        except SecretKeyError as error:
            return Finding(subject, "bad", error.message, "Give the key of then in TADA_SECRET_KEY.")
    with database.read() as session:
        blobs = doctor.deletions_before(session, datetime.now(UTC) - DELETED_WITHIN)
    if left or blobs:
        message = f"{left} that were promised are not carried out, {blobs} blobs that should be gone are there."
        return Finding(subject, "bad", message, advice)
    return Finding(subject, "ok", "all are carried out")


def _photos(database: Database, blobs: BlobStore) -> Finding:
    """Whether every photograph that the database names is in the store."""
    with database.read() as session:
        found = find_missing(meals.blob_keys(session), blobs)
    if found.missing:
        advice = (
            'Put them back from a backup (docs/backup.md, "Missing blobs"): their meals\' records stay, their '
            "estimates cannot be made again."
        )
        return Finding("photographs", "bad", f"{found.missing} of {found.total} missing: {_some(found.first)}.", advice)
    return Finding("photographs", "ok", f"all {found.total} are in the store")


def _sha256_of(blobs: BlobStore, key: str) -> str:
    digest = hashlib.sha256()
    for piece in blobs.stream(key):
        digest.update(piece)
    return digest.hexdigest()


def _some(keys: Sequence[str]) -> str:
    return ", ".join(keys[:LISTED]) + (" ..." if len(keys) > LISTED else "")


def _folder_of(url: str) -> Path | None:
    parts = urlsplit(url)
    return Path(unquote(parts.path)).resolve() if parts.scheme == "file" else None


def _bucket_of(url: str) -> str | None:
    parts = urlsplit(url)
    return parts.netloc if parts.scheme == "s3" else None


def _sqlite_file(settings: Settings) -> Path | None:
    url = sa.make_url(settings.resolved_database_url)
    return Path(url.database).resolve() if settings.is_embedded and url.database else None
