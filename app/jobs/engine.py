"""DBOS on our database: its tables, the queue that the API writes to, and the engine that a worker runs.

Everything here that begins with an underscore in DBOS is private there: the version is pinned and
tests/integration/jobs/test_dbos_contract.py fails when one of them changes.
"""

import logging
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa
import structlog
from dbos import DBOS, DBOSClient, DBOSConfig, DBOSPortableJSONSerializer, SQLAlchemyDatasource
from sqlalchemy import event
from sqlalchemy.orm import Session

from app.db.models import Job
from app.db.queries.jobs import DBOS_SCHEMA
from app.db.schema_state import MigrationBusyError
from app.db.session import BUSY_TIMEOUT_SECONDS, CONNECT_SECONDS, TCP_LIVENESS, Database, sqlite_connection_pragmas
from app.jobs.claims import Claims
from app.jobs.turns import HIGHEST_PRIORITY_NUMBER, Turns

APPLICATION = "tada-server"
# What a workflow's row means. A job is queued with the number of who queues it, and run by workers of that number or a
# higher one: it changes only when workers of the version before could not run the new rows.
JOB_PROTOCOL_VERSION = 1
FIRST_PROTOCOL_VERSION = 1
QUEUE = "estimates"
WORKFLOW = "estimate_meal"
# Times that a job is taken over from dead workers; then it is given up, visibly. Generous: a photograph can end its
# child but not the worker, so a worker's death tells of the machine and not of the job that it happened to have.
MAX_RECOVERIES = 25
POOL_SIZE = 5
MIGRATION_LOCK = 7_241_960_312  # one process at a time makes DBOS's tables; the number has no meaning
MIGRATION_POLL_SECONDS = 0.2
MIGRATION_TURN_SECONDS = 120.0  # while another process makes them; one that was stopped in it holds the lock for ever


def prepare_job_tables(database: Database, turn_seconds: float = MIGRATION_TURN_SECONDS) -> None:
    """Make or upgrade DBOS's tables; harmless if they are there, or if several processes do it at once.

    Raises MigrationBusyError when another process has been at it for longer than turn_seconds.
    """
    _quiet_dbos()
    if database.is_sqlite:
        _migrate_dbos(database)  # it takes SQLite's write lock first
        return
    with database.write_engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        # asked again and again, not waited for: DBOS builds indexes concurrently, and PostgreSQL lets that wait for
        # every statement under way, one that waits for our lock included
        deadline = time.monotonic() + turn_seconds
        while not connection.scalar(sa.text("SELECT pg_try_advisory_lock(:n)"), {"n": MIGRATION_LOCK}):
            if time.monotonic() > deadline:
                raise MigrationBusyError(
                    f"Another process makes the tables of jobs, for more than {turn_seconds:.0f} s: wait for it to end "
                    "(or end it, if it hangs), then do the same again."
                )
            time.sleep(MIGRATION_POLL_SECONDS)
        try:
            _migrate_dbos(database)
        finally:
            connection.execute(sa.text("SELECT pg_advisory_unlock(:n)"), {"n": MIGRATION_LOCK})


class JobQueue:
    """Where the API leaves jobs. One a process; needs the tables that `prepare_job_tables` makes."""

    def __init__(self, database: Database, *, protocol: int | None = None) -> None:
        _quiet_dbos()
        self._protocol = JOB_PROTOCOL_VERSION if protocol is None else protocol
        self._turns = Turns()
        self._client = DBOSClient(
            system_database_engine=database.write_engine,  # only for its dialect: we enqueue on the caller's session
            dbos_system_schema=DBOS_SCHEMA,
            serializer=DBOSPortableJSONSerializer(),
            application_name=APPLICATION,
            lazy=True,
        )

    def enqueue(self, session: Session, job: Job) -> None:
        """Make the job run, at its turn, once the session's transaction is committed; rolled back, it never was.

        The id of the request that we are in goes with it, so that the worker's log names it too.
        """
        self._turns.give(session, job)
        session.add(job)
        session.flush()
        request_id = structlog.contextvars.get_contextvars().get("request_id")
        self._client.enqueue_in_transaction(
            session,
            {
                "workflow_name": WORKFLOW,
                "queue_name": QUEUE,
                "workflow_id": str(job.id),
                "app_version": str(self._protocol),
                "priority": min(job.turn, HIGHEST_PRIORITY_NUMBER),
                "attributes": {"request_id": request_id} if request_id is not None else {},
            },
            str(job.id),
        )

    def close(self) -> None:
        """Let go of the client; the database's engines stay open."""
        self._client.destroy()


class Engine:
    """DBOS in one worker process. It is a singleton there: one Engine at a time."""

    def __init__(self, database: Database, executor_id: str, *, concurrency: int, protocol: int | None = None) -> None:
        self._executor_id = executor_id
        self._protocol = JOB_PROTOCOL_VERSION if protocol is None else protocol
        self._database = database
        self._concurrency = concurrency
        self._engine = _dbos_engine(database)

    def launch(self, make_workflow: Callable[[SQLAlchemyDatasource], Callable[[str], str]]) -> None:
        """Begin to claim jobs. make_workflow: from the datasource of its transactions to the workflow's function."""
        _quiet_dbos()
        self._dbos = DBOS(config=self._config())
        datasource = SQLAlchemyDatasource.create(
            self._database.url,
            engine=self._database.write_engine,
            schema=DBOS_SCHEMA,
            serializer=DBOSPortableJSONSerializer(),
            run_migrations=False,
        )
        DBOS.workflow(name=WORKFLOW, max_recovery_attempts=MAX_RECOVERIES)(make_workflow(datasource))
        DBOS.listen_queues([])  # it would claim as well, for all that it has room for
        with _told_once():
            DBOS.launch()
        first = min(FIRST_PROTOCOL_VERSION, self._protocol)
        versions = [str(number) for number in range(first, self._protocol + 1)]
        self._claims = Claims(self._dbos, QUEUE, self._executor_id, concurrency=self._concurrency, versions=versions)
        self._claims.start()

    def stop_claiming(self) -> None:
        """Claim no further job; those that run go on."""
        self._claims.stop()
        for stop in self._dbos.background_thread_stop_events:
            stop.set()

    def note_computing(self, workflow_id: str) -> None:
        """The job needs a child, maybe again."""
        self._claims.note_computing(workflow_id)

    def note_computed(self, workflow_id: str) -> None:
        """The job needs no child any more."""
        self._claims.note_computed(workflow_id)

    def requeue(self, workflow_id: str, executor_id: str) -> bool:
        """Put a job back into the queue, at its old turn, if that executor still has it. False: it has not."""
        return self._dbos._sys_db.reenqueue_for_recovery(workflow_id, [executor_id], QUEUE)  # noqa: SLF001

    def shut_down(self) -> None:
        """End DBOS's threads. What still runs is left as it is."""
        DBOS.destroy(destroy_registry=True)
        self._engine.dispose()

    def _config(self) -> DBOSConfig:
        return {
            "name": APPLICATION,
            "system_database_engine": self._engine,
            "dbos_system_schema": DBOS_SCHEMA,
            "application_version": str(self._protocol),
            "executor_id": self._executor_id,
            "serializer": DBOSPortableJSONSerializer(),
            "run_migrations": False,
            "enable_otlp": False,
            "log_level": "WARNING",
            "notification_coalesce_sec": 1.0,  # we send no notifications; the default wakes 100 times a second
        }


def _migrate_dbos(database: Database) -> None:
    DBOS.migrate(database.url, schema=DBOS_SCHEMA)
    SQLAlchemyDatasource.migrate(database.url, schema=DBOS_SCHEMA)


def _dbos_engine(database: Database) -> sa.Engine:
    """An engine of DBOS's own, which sets neither WAL nor our pragmas."""
    if not database.is_sqlite:
        # as our own engine: a worker whose network broke off would else beat its heart and never claim again
        liveness = {"connect_timeout": CONNECT_SECONDS, **TCP_LIVENESS}
        return sa.create_engine(database.url, pool_size=POOL_SIZE, pool_pre_ping=True, connect_args=liveness)
    engine = sa.create_engine(database.url, pool_size=POOL_SIZE, connect_args={"timeout": BUSY_TIMEOUT_SECONDS})

    @event.listens_for(engine, "connect")
    def prepare(connection: sqlite3.Connection, _record: Any) -> None:
        # the driver begins IMMEDIATE before a write and nothing before a read, which DBOS counts on: inside our
        # transaction it reads on another connection whether the job is still ours
        connection.isolation_level = "IMMEDIATE"
        sqlite_connection_pragmas(connection)

    return engine


@contextmanager
def _told_once() -> Iterator[None]:
    """What keeps DBOS from launching it raises, and logs with a traceback as well: whoever catches it tells of it."""

    def is_other(record: logging.LogRecord) -> bool:
        return not record.getMessage().startswith("DBOS failed to launch")

    logger = logging.getLogger("dbos")
    logger.addFilter(is_other)
    try:
        yield
    finally:
        logger.removeFilter(is_other)


_quieting = threading.Lock()


def _quiet_dbos() -> None:
    """DBOS logs by the root's handlers, from WARNING on, instead of printing by itself."""
    logger = logging.getLogger("dbos")
    with _quieting:
        if not any(isinstance(handler, logging.NullHandler) for handler in logger.handlers):
            logger.addHandler(logging.NullHandler())  # with a handler there, DBOS adds none
        logger.setLevel(logging.WARNING)
        logger.propagate = True
