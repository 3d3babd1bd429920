"""A worker's claim to be alive. PostgreSQL: a row with a heartbeat on the database's clock. SQLite: a lock of the OS.

A lease is taken before the first job is claimed. While it is held, nobody takes this worker's jobs over; once it is
taken away, `guard` refuses every write of the worker that had it.
"""

import contextlib
import fcntl
import json
import os
import socket
import time
import uuid
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app import __version__
from app.children.faults import JobLeft
from app.db.session import Database
from app.jobs import queries as jobs
from app.jobs.queries import Executor
from app.jobs.times import WorkerTimes


class Lease(Protocol):
    """The life of one worker process."""

    executor_id: str

    def acquire(self) -> None:
        """Begin to live."""
        ...

    def renew(self) -> bool:
        """A heartbeat. False: this worker was declared dead and must end. Raises on a passing fault of the database."""
        ...

    def guard(self, session: Session) -> None:
        """Keep the lease from being taken until the session's transaction ends. Raises JobLeft if it is lost."""
        ...

    def release(self) -> None:
        """End by itself, so that its jobs are taken over at once."""
        ...

    def bury(self, pending: set[str]) -> set[str]:
        """Take the leases of dead workers away; return who of `pending` (executors with claimed jobs) does not live.

        `pending` must have been read before: whoever is in it had a lease by then.
        """
        ...


def new_executor() -> Executor:
    """A name that no other process ever had, for one start of one worker."""
    host = socket.gethostname()
    return Executor(
        executor_id=f"{host[:24]}-{os.getpid()}-{uuid.uuid4().hex[:16]}",
        host=host[:255],
        pid=os.getpid(),
        version=__version__,
        started_at=datetime.now(UTC),
    )


def open_lease(database: Database, times: WorkerTimes) -> Lease:
    """The kind of lease that the database allows, not acquired yet."""
    if database.is_sqlite:
        return FileLease(lock_folder(database), new_executor())
    return DatabaseLease(database, new_executor(), times)


def living_workers(database: Database, times: WorkerTimes | None = None) -> list[Executor]:
    """Workers alive now, the oldest first."""
    if database.is_sqlite:
        files = lock_files(lock_folder(database))
        return sorted(filter(None, map(_read_if_locked, files)), key=lambda found: found.started_at)
    with database.read() as session:
        return jobs.fresh_leases(session, (times or WorkerTimes()).lease)


class DatabaseLease:
    """A row in worker_lease. All times are the database's, so that hosts' clocks do not matter."""

    def __init__(self, database: Database, executor: Executor, times: WorkerTimes) -> None:
        self.executor_id = executor.executor_id
        self._executor = executor
        self._database = database
        self._seconds = times.lease
        self._ahead: dict[tuple[str, datetime], float] = {}

    def acquire(self) -> None:
        """Insert the row: the first heartbeat."""
        with self._database.write() as session:
            jobs.insert_lease(session, self._executor)

    def renew(self) -> bool:
        """Move the heartbeat, be it late: only who takes the row away ends the lease.

        Else all workers of a machine too busy for heartbeats in time would end and start again for ever.
        """
        with self._database.write() as session:
            return jobs.renew_lease(session, self.executor_id)

    def guard(self, session: Session) -> None:
        """Lock the row in the session's transaction, so that a takeover comes wholly before or wholly after it."""
        if not jobs.hold_lease(session, self.executor_id, self._seconds):
            raise JobLeft

    def release(self) -> None:
        """Delete the row."""
        with contextlib.suppress(sa.exc.SQLAlchemyError), self._database.write() as session:
            jobs.delete_lease(session, self.executor_id)

    def bury(self, pending: set[str]) -> set[str]:
        """Delete the rows that ran out; who has no row does not live."""
        with self._database.write() as session:
            jobs.delete_expired_leases(session, self._seconds)
            for executor_id, heartbeat_at in self._stand_still(jobs.leases_ahead(session)):
                jobs.delete_lease_ahead(session, executor_id, heartbeat_at)
            return pending - jobs.leases(session)

    def _stand_still(self, ahead: set[tuple[str, datetime]]) -> list[tuple[str, datetime]]:
        """Heartbeats from a time to come that have not moved for a lease's time on our own clock.

        The database's clock went back. Who lives renews the heartbeat soon; who died before would else be taken for
        alive until the clock has caught up.
        """
        now = time.monotonic()
        self._ahead = {lease: self._ahead.get(lease, now) for lease in ahead}
        return [lease for lease, since in self._ahead.items() if now - since > self._seconds]


class FileLease:
    """A locked file in a folder beside the SQLite file. The kernel drops the lock when the process dies, in any way.

    A stopped process (SIGSTOP) keeps its lock and so its jobs: on one machine whoever stops it can also let it go on.
    """

    def __init__(self, folder: Path, executor: Executor) -> None:
        self.executor_id = executor.executor_id
        self._executor = executor
        self._path = folder / f"{executor.executor_id}.lock"
        self._file: int | None = None

    def acquire(self) -> None:
        """Make the file and lock it; if somebody took it for a dead worker's in between, make it again."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
            fcntl.flock(file, fcntl.LOCK_EX)  # who looks whether we live holds it for an instant
            if _is_still_there(file, self._path):
                break
            os.close(file)
        os.write(file, json.dumps(asdict(self._executor), default=datetime.isoformat).encode())
        self._file = file

    def renew(self) -> bool:
        """The kernel keeps the lock; only somebody who removes the file by hand ends it."""
        return self._file is not None and _is_still_there(self._file, self._path)

    def guard(self, session: Session) -> None:
        """The lock holds as long as this process lives, so also to the end of the transaction."""
        del session
        if not self.renew():
            raise JobLeft

    def release(self) -> None:
        """Remove the file, then let go of the lock."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None

    def bury(self, pending: set[str]) -> set[str]:
        """Remove the files that nobody locks; who has no file does not live."""
        for path in lock_files(self._path.parent):
            if path != self._path:
                _remove_if_unlocked(path)
        return {executor for executor in pending if not (self._path.parent / f"{executor}.lock").exists()}


def lock_folder(database: Database) -> Path:
    """Beside the SQLite file and named after it: all workers of one database look there, however they are set."""
    path = sa.make_url(database.url).database
    if not path:
        raise ValueError("workers need a database in a file")
    return Path(f"{Path(path).absolute()}.workers")


def lock_files(folder: Path) -> list[Path]:
    """The lock files of workers, dead or alive."""
    return sorted(folder.glob("*.lock"))


def _is_still_there(file: int, path: Path) -> bool:
    """Whether the path still leads to the open file."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return False
    mine = os.fstat(file)
    return (found.st_dev, found.st_ino) == (mine.st_dev, mine.st_ino)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int | None]:
    """The file, or None where it has gone meanwhile."""
    try:
        file = os.open(path, os.O_RDWR)
    except FileNotFoundError:
        yield None
        return
    try:
        yield file
    finally:
        os.close(file)


def _remove_if_unlocked(path: Path) -> None:
    with _opened(path) as file, contextlib.suppress(BlockingIOError):
        if file is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink(missing_ok=True)  # under the lock: a worker that is just starting sees it and makes it again


def _read_if_locked(path: Path) -> Executor | None:
    with _opened(path) as file:
        if file is None:
            return None
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            pass
        else:
            return None
        try:
            fields = json.loads(os.pread(file, 4096, 0))
        except ValueError:  # locked a moment ago and not written yet
            return None
    return Executor(**(fields | {"started_at": datetime.fromisoformat(fields["started_at"])}))
