"""What we use of DBOS beyond its documented interface. A failure here means: read its source again before upgrading."""

import importlib.metadata
import inspect

import dbos
import sqlalchemy as sa
from dbos import DBOS
from dbos._error import DBOSBaseException, DBOSWorkflowConflictIDError
from dbos._schemas.system_database import SystemSchema
from dbos._sys_db import SystemDatabase

from app.jobs.engine import prepare_job_tables


def test_version_is_the_one_whose_source_was_read():
    assert importlib.metadata.version("dbos") == "3.4.0"


def test_recovery_takes_executors_and_puts_their_jobs_back_into_the_queue():
    assert list(inspect.signature(DBOS._recover_pending_workflows).parameters) == ["executor_ids"]
    source = inspect.getsource(dbos._recovery._recover_workflow)
    assert "reenqueue_for_recovery(" in source  # through the queue's claim, never by running it at once
    parameters = list(inspect.signature(SystemDatabase.reenqueue_for_recovery).parameters)
    assert parameters == ["self", "workflow_id", "executor_ids", "recovery_queue_name"]


def test_losing_a_workflow_is_no_exception_that_our_tries_would_catch():
    assert issubclass(DBOSWorkflowConflictIDError, DBOSBaseException)
    assert not issubclass(DBOSBaseException, Exception)


def test_stop_events_end_the_claiming_threads():
    assert "self.background_thread_stop_events.append(evt)" in inspect.getsource(DBOS._launch)


def test_columns_that_we_read_are_there(database):
    prepare_job_tables(database)
    assert {"workflow_uuid", "status", "executor_id", "application_name"} <= set(SystemSchema.workflow_status.c.keys())
    with database.read_engine.connect() as connection:
        schema = None if database.is_sqlite else "dbos"
        names = {column["name"] for column in sa.inspect(connection).get_columns("workflow_status", schema=schema)}
    assert {"workflow_uuid", "status", "executor_id", "application_name"} <= names
