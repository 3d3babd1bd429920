"""Checks of where data are stored: database, blob store, and the ledger of erasures."""

import hashlib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from urllib.parse import unquote, urlsplit

import sqlalchemy as sa
import sqlalchemy.exc

from app import __version__
from app.core.errors import TadaError
from app.core.settings import Settings
from app.db.schema_state import SchemaState, current_revision, head_revision, schema_state
from app.exports.releases import queries as releases
from app.meals.stored import queries as meals
from app.operations import queries as doctor
from app.operations.doctor.finding import Deployment, Verdict, bad, note, ok, some
from app.operations.queries import PostgresFacts, database_now
from app.people import privacy_queries as privacy
from app.people.access.secret_box import SecretKeyError, require_same_key
from app.people.privacy_queries import clock_doubted_seconds
from app.privacy.erasure_ledger import KINDS, count_missing
from app.privacy.missing_blobs import find_missing
from app.storage.blob_store import BlobStore

# server_version_num; older servers do not detect dead clients (app/db/migrate.py)
LEAST_POSTGRES = 140_000
# a larger difference distorts expiry of tokens, retention and ages in the queue
CLOCKS_APART_SECONDS = 5.0
BACK_SECONDS = 60.0
BUSY_SHARE = 0.8  # of max_connections
MOUNTS = Path("/proc/self/mountinfo")
NETWORK_FILE_SYSTEMS = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "ceph", "glusterfs", "lustre", "afs", "fuse.sshfs", "fuse.s3fs",
     "fuse.glusterfs", "fuse.ceph-fuse", "fuse.rclone", "ocfs2", "gpfs", "beegfs"}
)  # fmt: skip
READ_BACK = 20  # of the newest photographs
ROOMY = 4  # times TADA_MIN_FREE_BYTES
UNDER_WAY = timedelta(minutes=10)  # a more recent erasure is still being carried out
DELETED_WITHIN = timedelta(hours=1)  # erased blobs are deleted within seconds while a worker runs
GIBIBYTE = 1024**3


def look_at_connection(deployment: Deployment) -> Verdict:
    """Check that the database exists, without creating it."""
    database = deployment.database
    path = Path(sa.make_url(database.url).database or "")
    if database.is_sqlite and (not path.is_file() or not path.stat().st_size):
        advice = "Run `tada db upgrade`, or set TADA_DATA_DIR or TADA_DATABASE_URL to where it is."
        return bad(f"there is none at {path.absolute()}.", advice)
    try:
        with database.read() as session:
            session.execute(sa.text("SELECT 1"))
    except sqlalchemy.exc.SQLAlchemyError as error:
        words = " ".join(str(getattr(error, "orig", error)).split())[:300]
        return bad(
            f"it does not answer: {words}.",
            "Start it, or set TADA_DATABASE_URL to where it is; uploads are refused until then, nothing is lost.",
        )
    return ok("SQLite, on this machine" if database.is_sqlite else "PostgreSQL")


def look_at_schema(deployment: Deployment) -> Verdict:
    """Check that the schema is this program's."""
    revision, upgrade = current_revision(deployment.database), "Run `tada db upgrade`."
    state = schema_state(deployment.database)
    if revision is None:
        return bad("the database is empty.", upgrade)
    if state is SchemaState.OLDER:
        return bad(f"it is {revision}, older than {head_revision()} of {__version__}.", upgrade)
    if state is SchemaState.NEWER:
        message = (
            f"it is {revision}, which {__version__} does not know: a newer program has migrated it."
        )
        return note(message, "Finish the upgrade: replace what still runs this version.")
    return ok(revision)


def look_at_key_of_database(deployment: Deployment) -> Verdict | None:
    """Check that the secret key is the one that the database was first used with."""
    if deployment.box is not None:
        try:
            require_same_key(deployment.database, deployment.box)
        except SecretKeyError as error:
            return bad(str(error), "If it is lost for good: docs/deployment.md, A lost secret key.")
    return None


def look_at_clock(deployment: Deployment) -> Verdict:
    """Compare this machine's clock with the database's, and with the newest event."""
    with deployment.database.read() as session:
        there = database_now(session)
        here = datetime.now(UTC)
        last_event = doctor.last_event_at(session)
        doubted = clock_doubted_seconds(session)
    apart = abs((here - there).total_seconds())
    if apart > CLOCKS_APART_SECONDS:
        return bad(
            f"this machine's and the database's are {apart:.0f} s apart.",
            "Keep both by NTP (chrony, systemd-timesyncd): tokens, retention and ages go by them.",
        )
    if last_event is not None and (last_event - here).total_seconds() > BACK_SECONDS:
        return bad(
            f"the newest event of the audit log is in the future: {last_event.isoformat(timespec='seconds')}.",
            "The clock has gone back, or was ahead: set it by NTP before retention erases by it.",
        )
    if doubted > 0:
        return bad(
            f"it was more than a day off: nothing is erased for its age for another {doubted / 3600:.0f} h of work.",
            "Set it by NTP. If it is right: tada doctor --trust-clock.",
        )
    return ok(f"{apart:.1f} s from the database's")


def look_at_server_version(deployment: Deployment) -> Verdict | None:
    """Check PostgreSQL's version."""
    if (facts := _postgres_facts(deployment)) is None:
        return None
    version = int(facts.settings["server_version_num"])
    if version < LEAST_POSTGRES:
        return bad(f"{version // 10_000} is older than 14.", "Upgrade the server.")
    return ok(f"version {version // 10_000}.{version % 10_000}")


def look_at_durability(deployment: Deployment) -> Verdict | None:
    """Check that PostgreSQL's commits are durable."""
    if (facts := _postgres_facts(deployment)) is None:
        return None
    off = [
        name
        for name in ("fsync", "synchronous_commit", "full_page_writes")
        if facts.settings.get(name) == "off"
    ]
    if off:
        return bad(
            f"off: {', '.join(off)}. An acknowledged meal can be lost with the power.",
            "Turn on what is off, in postgresql.conf and for the role and the database.",
        )
    return ok("what is committed is on disk")


def look_at_encoding(deployment: Deployment) -> Verdict | None:
    """Check that PostgreSQL can store all names."""
    facts = _postgres_facts(deployment)
    if facts is None or facts.settings["server_encoding"] == "UTF8":
        return None
    message = f"the database's encoding is {facts.settings['server_encoding']}: names of foods do not fit."
    return bad(message, "Make a database with ENCODING 'UTF8' and restore a backup into it.")


def look_at_session_options(deployment: Deployment) -> Verdict | None:
    """Check that the options of our connections reach PostgreSQL."""
    facts = _postgres_facts(deployment)
    if facts is None or (
        facts.settings["TimeZone"] == "UTC" and facts.settings["statement_timeout"] != "0"
    ):
        return None
    return bad(
        "the options that we connect with (timezone, statement_timeout) do not arrive.",
        "A pooler drops them: let it pass startup options on, or connect to PostgreSQL itself.",
    )


def look_at_connections(deployment: Deployment) -> Verdict | None:
    """Check that PostgreSQL has enough connections for a server and the running workers."""
    if (facts := _postgres_facts(deployment)) is None:
        return None
    limits, workers = deployment.database.limits, len(deployment.worker_versions)
    room = int(facts.settings["max_connections"]) - int(
        facts.settings["superuser_reserved_connections"]
    )
    process = limits.size + limits.overflow
    needed = (1 + workers) * process
    usage = f"{facts.connections} of {room} in use; a server or a worker takes up to {process}"
    advice = (
        "Raise max_connections, or lower TADA_DATABASE_POOL_SIZE and TADA_DATABASE_POOL_OVERFLOW."
    )
    if facts.connections > BUSY_SHARE * room:
        return bad(f"nearly none is left: {usage}.", advice)
    if needed > room:
        return bad(f"one server and {workers} workers may want {needed}: {usage}.", advice)
    return ok(usage)


def look_at_sqlite_file(deployment: Deployment) -> Verdict | None:
    """Check that the file system has reliable locks, and that the journal is a write-ahead log."""
    database = deployment.database
    if not database.is_sqlite:
        return None
    with database.read() as session:
        mode = doctor.journal_mode(session)
    path = Path(sa.make_url(database.url).database or "").absolute()
    kind = file_system_of(path)
    if kind in NETWORK_FILE_SYSTEMS:
        return bad(
            f"{path} lies on a network file system ({kind}), whose locks SQLite cannot trust: the file may be ruined.",
            "Move TADA_DATA_DIR to a local disk, or use PostgreSQL.",
        )
    if mode.lower() != "wal":
        message = f"its journal is {mode}, not a write-ahead log: readers and writers wait for each other."
        return bad(message, "Move it to a file system that has shared memory maps.")
    return ok(f"{path}, on {kind or 'a file system of unknown kind'}")


def file_system_of(path: Path) -> str | None:
    """Return the type of a path's file system from Linux's mount table; None: not known."""
    try:
        lines = MOUNTS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    kind, depth = None, -1
    for line in lines:
        before, _, after = line.partition(" - ")
        fields = before.split()
        if len(fields) < 5 or not after:
            continue
        point = Path(fields[4].replace("\\040", " "))
        if path.is_relative_to(point) and len(point.parts) >= depth:
            kind, depth = after.split()[0], len(point.parts)
    return kind


def look_at_store(deployment: Deployment) -> Verdict:
    """Check that the blob store can be written."""
    try:
        deployment.blobs.check()
    except (TadaError, OSError) as error:
        return bad(
            f"it cannot be written: {_why(error)}.",
            "Mend it, or set TADA_BLOB_URL to where it is; uploads are refused until then, nothing is lost.",
        )
    return ok("written, and what was written removed")


def look_at_disk(deployment: Deployment) -> Verdict:
    """Check that there is enough free space."""
    free, least = deployment.blobs.free_bytes(), deployment.settings.min_free_bytes
    room = f"{free / GIBIBYTE:.1f} GiB free where uploads are written; below {least / GIBIBYTE:.1f} they are refused"
    advice = "Make room, or move the data to a larger disk."
    if free < least:
        return bad(f"{room}: no meal is accepted.", advice)
    return note(f"{room}.", advice) if free < ROOMY * least else ok(room)


def look_at_versions(deployment: Deployment) -> Verdict | None:
    """Check that the store does not keep deleted blobs."""
    if not deployment.blobs.keeps_versions:
        return None
    return bad(
        "the bucket keeps what is deleted: a participant's erased photographs are still there.",
        "Add a lifecycle rule that removes noncurrent versions within days, or turn versioning off.",
    )


def look_at_photographs(deployment: Deployment) -> Verdict:
    """Check that every photograph named in the database is in the store."""
    with deployment.database.read() as session:
        result = find_missing(meals.blob_keys(session), deployment.blobs)
    if not result.missing:
        return ok(f"all {result.total} are in the store")
    return bad(
        f"{result.missing} of {result.total} missing: {some(list(result.first))}.",
        'Put them back from a backup (docs/backup.md, "Missing blobs"): their meals\' records stay, their '
        "estimates cannot be made again.",
    )


def look_at_newest_photographs(deployment: Deployment) -> Verdict:
    """Check that the newest photographs are stored unchanged."""
    with deployment.database.read() as session:
        newest = doctor.newest_photographs(session, READ_BACK)
    damaged, unread = [], []
    for key, sha256 in newest:
        try:
            if _sha256_of(deployment.blobs, key) != sha256:
                damaged.append(key)
        except (TadaError, OSError):
            unread.append(key)
    if not damaged and not unread:
        return ok(f"{len(newest)} read back, bit for bit")
    return bad(
        f"of {len(newest)} {len(damaged)} are not what was sealed, {len(unread)} cannot be read: "
        f"{some(damaged + unread)}.",
        "Look at the disk or the bucket before anything else writes to it, then restore a backup.",
    )


def look_at_release_files(deployment: Deployment) -> Verdict:
    """Check that releases' files are in the store, so that a loss is known before an erasure must change them."""
    with deployment.database.read() as session:
        keys = releases.blob_keys(session)
    lost = [key for key in keys if not deployment.blobs.has(key)]
    if not lost:
        return ok(f"all {len(keys)} are in the store")
    advice = 'Put them back from a backup (docs/exports.md, "A lost file").'
    return bad(f"{len(lost)} of {len(keys)} missing: {some(lost)}.", advice)


def look_at_ledger(deployment: Deployment) -> Verdict:
    """Check that erasures can be recorded, in a place that is not lost together with the data."""
    try:
        deployment.erasures.check()
    except (TadaError, OSError) as error:
        advice = "Mend it, or set TADA_ERASURE_URL to where it is."
        return bad(f"it cannot be written: {_why(error)}. Nobody can be erased.", advice)
    settings = deployment.settings
    ledger, blobs = settings.resolved_erasure_url, settings.resolved_blob_url
    elsewhere = (
        "Set TADA_ERASURE_URL to another disk, machine or bucket, and move its entries there."
    )
    folder = _folder_of(ledger)
    if folder is None:
        if urlsplit(ledger).netloc == urlsplit(blobs).netloc:
            return note(
                "it lies in the photographs' bucket: whatever takes the bucket takes both.",
                elsewhere,
            )
    elif folder.is_relative_to(settings.data_dir.resolve()):
        return note(
            "it lies in TADA_DATA_DIR: whoever restores that folder brings it back as it was, and erased people too.",
            "Set TADA_ERASURE_URL to another place, or leave the folder out of backups of files.",
        )
    elif any(
        disk_of(folder) == disk_of(path)
        for path in (_folder_of(blobs), _sqlite_file(settings))
        if path
    ):
        return note(
            "it lies on the disk of the photographs or of the database: a disk that dies takes both.",
            elsewhere,
        )
    return ok("written, and apart from what it is to outlive")


def look_at_ledger_entries(deployment: Deployment) -> Verdict | None:
    """Check that the ledger is the one in which this database's erasures were recorded."""
    missing = (
        count_missing(deployment.database, deployment.ledger)
        if deployment.ledger is not None
        else 0
    )
    if not missing:
        return None
    return note(
        f"it lacks {missing} erasures that the database records: it is not the original ledger.",
        "Copy the original ledger's entries into it, or a restored backup brings back erased people.",
    )


def look_at_erasures(deployment: Deployment) -> Verdict | None:
    """Check that all erasures have been carried out."""
    if (ledger := deployment.ledger) is None:
        return None
    before, unfinished_count = datetime.now(UTC) - UNDER_WAY, 0
    for kind in KINDS:
        recorded = set(ledger.digests(kind, before))
        with deployment.database.read() as session:
            unfinished = recorded - privacy.tombstones_among(session, kind, recorded)
        unfinished_count += len(unfinished)
        try:
            for digest in sorted(unfinished)[:1]:
                ledger.read(kind, digest)
        except SecretKeyError as error:
            return bad(error.message, "Set TADA_SECRET_KEY to the original key.")
    with deployment.database.read() as session:
        blobs = doctor.deletions_before(session, datetime.now(UTC) - DELETED_WITHIN)
    if unfinished_count or blobs:
        return bad(
            f"{unfinished_count} promised erasures are not carried out, {blobs} blobs still have to be deleted.",
            "A worker carries them out within the hour: start one, and look at its log.",
        )
    return ok("all are carried out")


def disk_of(path: Path) -> int:
    """Return the id of the file system that a path is on, or will be created on."""
    return next(existing for existing in (path, *path.parents) if existing.exists()).stat().st_dev


def _postgres_facts(deployment: Deployment) -> PostgresFacts | None:
    """Return facts about PostgreSQL; None on SQLite."""
    if deployment.database.is_sqlite:
        return None
    with deployment.database.read() as session:
        return doctor.postgres_facts(session)


def _why(error: TadaError | OSError) -> str:
    return error.message if isinstance(error, TadaError) else (error.strerror or str(error))


def _sha256_of(blobs: BlobStore, key: str) -> str:
    digest = hashlib.sha256()
    for piece in blobs.stream(key):
        digest.update(piece)
    return digest.hexdigest()


def _folder_of(url: str) -> Path | None:
    parts = urlsplit(url)
    return Path(unquote(parts.path)).resolve() if parts.scheme == "file" else None


def _sqlite_file(settings: Settings) -> Path | None:
    url = sa.make_url(settings.resolved_database_url)
    return Path(url.database).resolve() if settings.is_embedded and url.database else None
