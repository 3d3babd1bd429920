"""A worker's lease.

PostgreSQL: a row with a heartbeat on the database's clock. SQLite: a locked file.

A worker acquires its lease before it claims jobs. While it holds the lease, no other worker takes
its jobs over; once the lease is taken away, `guard` refuses every write of the worker that had it.
"""

import contextlib
import fcntl
import json
import os
import socket
import time
import uuid
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Protocol

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app import __version__
from app.children.faults import JobLeft
from app.db.session import Database
from app.jobs.queries import WorkerTimes
from app.meals.stored.job_models import WorkerLease


@dataclass(frozen=True, slots=True)
class Executor:
    """A worker process, as /readyz shows it."""

    executor_id: str
    host: str
    pid: int
    version: str
    started_at: datetime


class Lease(Protocol):
    """The lease of one worker process."""

    executor_id: str

    def acquire(self) -> None:
        """Take the lease."""
        ...

    def renew(self) -> bool:
        """Send a heartbeat.

        Returns False if the lease was taken: the worker must end. Raises if the database fails.
        """
        ...

    def guard(self, session: Session) -> None:
        """Keep the lease from being taken until the session's transaction ends.

        Raises JobLeft if it is lost.
        """
        ...

    def release(self) -> None:
        """Give the lease up, so that the worker's jobs are taken over at once."""
        ...

    def bury(self, pending: set[str]) -> set[str]:
        """Take away the leases of dead workers.

        Returns those of `pending`, executors with claimed jobs, that are dead.

        `pending` must be read before the call: all executors in it had a lease by then.
        """
        ...


def new_executor() -> Executor:
    """Return a unique executor for one start of a worker."""
    host = socket.gethostname()
    return Executor(
        executor_id=f"{host[:24]}-{os.getpid()}-{uuid.uuid4().hex[:16]}",
        host=host[:255],
        pid=os.getpid(),
        version=__version__,
        started_at=datetime.now(UTC),
    )


def open_lease(database: Database, times: WorkerTimes) -> Lease:
    """Return the kind of lease that fits the database, not acquired yet."""
    if database.is_sqlite:
        return FileLease(lock_folder(database), new_executor())
    return DatabaseLease(database, new_executor(), times)


def living_workers(database: Database, times: WorkerTimes | None = None) -> list[Executor]:
    """Return the living workers, the oldest first."""
    if database.is_sqlite:
        files = lock_files(lock_folder(database))
        return sorted(
            filter(None, map(_read_if_locked, files)), key=lambda executor: executor.started_at
        )
    seconds = (times or WorkerTimes()).lease
    # if the database's clock went back, a living worker has renewed its heartbeat since
    is_past = WorkerLease.heartbeat_at < _clock() + timedelta(seconds=seconds)
    query = sa.select(WorkerLease).where(_is_fresh(seconds), is_past)
    with database.read() as session:
        rows = session.scalars(query.order_by(WorkerLease.started_at, WorkerLease.executor_id))
        return [
            Executor(row.executor_id, row.host, row.pid, row.version, row.started_at)
            for row in rows
        ]


class DatabaseLease:
    """A row in worker_lease.

    All times are on the database's clock, so that hosts' clocks do not matter.
    """

    def __init__(self, database: Database, executor: Executor, times: WorkerTimes) -> None:
        self.executor_id = executor.executor_id
        self._executor = executor
        self._database = database
        self._seconds = times.lease
        self._ahead: dict[tuple[str, datetime], float] = {}

    def acquire(self) -> None:
        """Insert the row with the first heartbeat."""
        with self._database.write() as session:
            row = sa.insert(WorkerLease).values(**asdict(self._executor), heartbeat_at=_clock())
            session.execute(row)

    def renew(self) -> bool:
        """Renew the heartbeat, even a late one: only a worker that deletes the row ends the lease.

        Otherwise workers of a machine that is too busy for timely heartbeats would restart for
        ever.
        """
        with self._database.write() as session:
            renewed = sa.update(WorkerLease).where(WorkerLease.executor_id == self.executor_id)
            renewed = renewed.values(heartbeat_at=_clock())
            return session.scalar(renewed.returning(WorkerLease.executor_id)) is not None

    def guard(self, session: Session) -> None:
        """Lock the row in the session's transaction: a takeover happens before or after it.

        FOR KEY SHARE: the worker's own heartbeats are not blocked, and a takeover skips the row.
        """
        # a worker that is stopped within its transaction must not keep the rows locked against a
        # takeover
        milliseconds = int(self._seconds * 1000)
        session.execute(sa.text(f"SET LOCAL idle_in_transaction_session_timeout = {milliseconds}"))
        query = sa.select(WorkerLease.executor_id)
        query = query.where(WorkerLease.executor_id == self.executor_id)
        if session.scalar(query.with_for_update(read=True, key_share=True)) is None:
            raise JobLeft

    def release(self) -> None:
        """Delete the row."""
        row = sa.delete(WorkerLease).where(WorkerLease.executor_id == self.executor_id)
        with contextlib.suppress(sa.exc.SQLAlchemyError), self._database.write() as session:
            session.execute(row)

    def bury(self, pending: set[str]) -> set[str]:
        """Delete expired rows, but never our own; an executor without a row is dead."""
        name, heartbeat_at = WorkerLease.executor_id, WorkerLease.heartbeat_at
        with self._database.write() as session:
            _delete(session, ~_is_fresh(self._seconds), name != self.executor_id)
            ahead = session.execute(sa.select(name, heartbeat_at).where(heartbeat_at > _clock()))
            for executor_id, since in self._stalled({(row[0], row[1]) for row in ahead}):
                _delete(session, name == executor_id, heartbeat_at == since)
            return pending - set(session.scalars(sa.select(name)))

    def _stalled(self, ahead: set[tuple[str, datetime]]) -> list[tuple[str, datetime]]:
        """Return leases whose heartbeat lies in the future and has not moved for a lease's time on our own clock.

        The database's clock went back. A living worker renews its heartbeat soon; a worker that
        died before would otherwise seem alive until the clock has caught up.
        """
        now = time.monotonic()
        self._ahead = {lease: self._ahead.get(lease, now) for lease in ahead}
        ripe = [lease for lease, since in self._ahead.items() if now - since > self._seconds]
        return [lease for lease in ripe if lease[0] != self.executor_id]


class FileLease:
    """A locked file in a folder beside the SQLite file.

    The kernel drops the lock however the process dies.

    A stopped process (SIGSTOP) keeps its lock and its jobs: on one machine, whoever stops it can
    also continue it.
    """

    def __init__(self, folder: Path, executor: Executor) -> None:
        self.executor_id = executor.executor_id
        self._executor = executor
        self._path = folder / f"{executor.executor_id}.lock"
        self._file: int | None = None

    def acquire(self) -> None:
        """Create the file and lock it; again, if another worker removed it before it was locked."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
            # a worker that checks whether we live holds the lock for a moment
            fcntl.flock(file, fcntl.LOCK_EX)
            if _is_still_there(file, self._path):
                break
            os.close(file)
        os.write(file, json.dumps(asdict(self._executor), default=datetime.isoformat).encode())
        self._file = file

    def renew(self) -> bool:
        """Return whether the file is still there: the kernel keeps the lock unless somebody removes the file."""
        return self._file is not None and _is_still_there(self._file, self._path)

    def guard(self, session: Session) -> None:
        """Check the lock, which then lasts as long as this process, and so to the end of the transaction."""
        del session
        if not self.renew():
            raise JobLeft

    def release(self) -> None:
        """Remove the file, then drop the lock."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None

    def bury(self, pending: set[str]) -> set[str]:
        """Remove unlocked files; an executor without a file is dead."""
        for path in lock_files(self._path.parent):
            if path != self._path:
                _remove_if_unlocked(path)
        return {
            executor
            for executor in pending
            if not (self._path.parent / f"{executor}.lock").exists()
        }


def _delete(session: Session, *conditions: sa.ColumnElement[bool]) -> None:
    """Delete leases, but those under which a worker is just saving."""
    chosen = sa.select(WorkerLease.executor_id).where(*conditions)
    chosen = chosen.with_for_update(skip_locked=True)
    names = sa.select(chosen.subquery().c.executor_id)
    session.execute(
        sa.delete(WorkerLease)
        .where(WorkerLease.executor_id.in_(names))
        .execution_options(synchronize_session=False)
    )


def _clock() -> sa.Function[datetime]:
    return sa.func.clock_timestamp(type_=sa.DateTime(timezone=True))


def _is_fresh(lease_seconds: float) -> sa.ColumnElement[bool]:
    return WorkerLease.heartbeat_at > _clock() - timedelta(seconds=lease_seconds)


def lock_folder(database: Database) -> Path:
    """Return the folder beside the SQLite file, named after it: all workers of the database use it."""
    path = sa.make_url(database.url).database
    if not path:
        raise ValueError("workers need a database in a file")
    return Path(f"{Path(path).absolute()}.workers")


def lock_files(folder: Path) -> list[Path]:
    """Return the lock files of workers, dead or alive."""
    return sorted(folder.glob("*.lock"))


def _is_still_there(file: int, path: Path) -> bool:
    """Whether the path still refers to the open file."""
    try:
        at_path = path.stat()
    except FileNotFoundError:
        return False
    opened = os.fstat(file)
    return (at_path.st_dev, at_path.st_ino) == (opened.st_dev, opened.st_ino)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int | None]:
    """Open the file; None if it no longer exists."""
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
            # under the lock: a worker that is just starting notices it and creates the file again
            path.unlink(missing_ok=True)


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
        except ValueError:  # locked a moment ago and not yet written
            return None
    return Executor(**(fields | {"started_at": datetime.fromisoformat(fields["started_at"])}))
