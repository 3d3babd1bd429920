"""What `tada doctor` says of the database: there, of this program's schema, durable, on time, with room for us."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa
import sqlalchemy.exc

from app import __version__
from app.db.queries import doctor
from app.db.queries.doctor import PostgresFacts
from app.db.queries.figures import database_now
from app.db.schema_state import SchemaState, current_revision, head_revision, schema_state
from app.db.session import Database
from app.services.finding import Finding

LEAST_POSTGRES = 140_000  # server_version_num; older ones do not notice that a client has died (app/db/migrate.py)
CLOCKS_APART_SECONDS = 5.0  # more, and tokens, retention and ages of the queue are off
BACK_SECONDS = 60.0
BUSY_SHARE = 0.8  # of max_connections
MOUNTS = Path("/proc/self/mountinfo")
NETWORK_FILE_SYSTEMS = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "ceph", "glusterfs", "lustre", "afs", "fuse.sshfs", "fuse.s3fs",
     "fuse.glusterfs", "fuse.ceph-fuse", "fuse.rclone", "ocfs2", "gpfs", "beegfs"}
)  # fmt: skip


def look_at_connection(database: Database) -> Finding:
    """Whether it answers at all."""
    try:
        with database.read() as session:
            session.execute(sa.text("SELECT 1"))
    except sqlalchemy.exc.SQLAlchemyError as error:
        words = " ".join(str(getattr(error, "orig", error)).split())[:300]
        return Finding(
            "database",
            "bad",
            f"it does not answer: {words}.",
            "Start it, or set TADA_DATABASE_URL to where it is; uploads are refused until then, nothing is lost.",
        )
    return Finding("database", "ok", "SQLite, on this machine" if database.is_sqlite else "PostgreSQL")


def look_at_schema(database: Database) -> Iterator[Finding]:
    """Whether it is this program's."""
    upgrade = "Run `tada db upgrade`."
    found = current_revision(database)
    state = schema_state(database)
    if found is None:
        yield Finding("schema", "bad", "the database is empty.", upgrade)
        return
    if state is SchemaState.OLDER:
        yield Finding("schema", "bad", f"it is {found}, older than {head_revision()} of {__version__}.", upgrade)
        return
    if state is SchemaState.NEWER:
        message = f"it is {found}, which {__version__} does not know: a newer program has been here."
        yield Finding("schema", "note", message, "Finish the upgrade: replace what still runs this version.")
    else:
        yield Finding("schema", "ok", found)


def look_at_database(database: Database, *, workers_alive: int) -> Iterator[Finding]:
    """How it is set up. Only where it answers and has our schema."""
    with database.read() as session:
        there = database_now(session)
        here = datetime.now(UTC)
        last_event = doctor.last_event_at(session)
        facts = None if database.is_sqlite else doctor.postgres_facts(session)
        mode = doctor.journal_mode(session) if database.is_sqlite else None
    yield _clock(here, there, last_event)
    if facts is not None:
        yield from _postgres(facts, database, workers_alive)
    else:
        yield _sqlite_file(database, mode or "")


def _clock(here: datetime, there: datetime, last_event: datetime | None) -> Finding:
    apart = abs((here - there).total_seconds())
    if apart > CLOCKS_APART_SECONDS:
        return Finding(
            "clock",
            "bad",
            f"this machine's and the database's are {apart:.0f} s apart.",
            "Keep both by NTP (chrony, systemd-timesyncd): tokens, retention and ages go by them.",
        )
    if last_event is not None and (last_event - here).total_seconds() > BACK_SECONDS:
        return Finding(
            "clock",
            "bad",
            f"the newest event of the audit log is of {last_event.isoformat(timespec='seconds')}, which is to come.",
            "The clock has gone back, or was ahead: set it by NTP before retention erases by it.",
        )
    return Finding("clock", "ok", f"{apart:.1f} s from the database's")


def _postgres(facts: PostgresFacts, database: Database, workers_alive: int) -> Iterator[Finding]:
    settings = facts.settings
    version = int(settings["server_version_num"])
    if version < LEAST_POSTGRES:
        yield Finding("postgresql", "bad", f"{version // 10_000} is older than 14.", "Upgrade the server.")
    else:
        yield Finding("postgresql", "ok", f"version {version // 10_000}.{version % 10_000}")
    off = [name for name in ("fsync", "synchronous_commit", "full_page_writes") if settings.get(name) == "off"]
    if off:
        yield Finding(
            "durability",
            "bad",
            f"off: {', '.join(off)}. An acknowledged meal can be lost with the power.",
            "Turn on what is off, in postgresql.conf and for the role and the database.",
        )
    else:
        yield Finding("durability", "ok", "what is committed is on disk")
    if settings["server_encoding"] != "UTF8":
        message = f"the database's encoding is {settings['server_encoding']}: names of foods do not fit."
        yield Finding("encoding", "bad", message, "Make a database with ENCODING 'UTF8' and restore a backup into it.")
    if settings["TimeZone"] != "UTC" or settings["statement_timeout"] == "0":
        yield Finding(
            "connection",
            "bad",
            "the options that we connect with (timezone, statement_timeout) do not arrive.",
            "A pooler drops them: let it pass startup options on, or connect to PostgreSQL itself.",
        )
    yield _connections(facts, database, workers_alive)


def _connections(facts: PostgresFacts, database: Database, workers_alive: int) -> Finding:
    room = int(facts.settings["max_connections"]) - int(facts.settings["superuser_reserved_connections"])
    process = database.limits.size + database.limits.overflow
    needed = (1 + workers_alive) * process
    said = f"{facts.connections} of {room} in use; a server or a worker takes up to {process}"
    advice = "Raise max_connections, or lower TADA_DATABASE_POOL_SIZE and TADA_DATABASE_POOL_OVERFLOW."
    if facts.connections > BUSY_SHARE * room:
        return Finding("connections", "bad", f"nearly none is left: {said}.", advice)
    if needed > room:
        message = f"one server and {workers_alive} workers may want {needed}: {said}."
        return Finding("connections", "bad", message, advice)
    return Finding("connections", "ok", said)


def _sqlite_file(database: Database, mode: str) -> Finding:
    path = Path(sa.make_url(database.url).database or "").absolute()
    kind = file_system_of(path)
    if kind in NETWORK_FILE_SYSTEMS:
        return Finding(
            "sqlite file",
            "bad",
            f"{path} lies on a network file system ({kind}), whose locks SQLite cannot trust: the file may be ruined.",
            "Move TADA_DATA_DIR to a local disk, or use PostgreSQL.",
        )
    if mode.lower() != "wal":
        message = f"its journal is {mode}, not a write-ahead log: readers and writers wait for each other."
        return Finding("sqlite file", "bad", message, "Move it to a file system that has shared memory maps.")
    return Finding("sqlite file", "ok", f"{path}, on {kind or 'a file system of unknown kind'}")


def file_system_of(path: Path) -> str | None:
    """The kind of file system that a path lies on, as Linux tells; None: not told."""
    try:
        lines = MOUNTS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    found, depth = None, -1
    for line in lines:
        before, _, after = line.partition(" - ")
        fields = before.split()
        if len(fields) < 5 or not after:
            continue
        point = Path(fields[4].replace("\\040", " "))
        if path.is_relative_to(point) and len(point.parts) >= depth:
            found, depth = after.split()[0], len(point.parts)
    return found
