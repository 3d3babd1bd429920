"""What we use of DBOS beyond its documented interface. A failure here means: read its source again before upgrading."""

import importlib.metadata
import inspect

import dbos
import sqlalchemy as sa
from dbos import DBOS
from dbos._core import WorkflowHandleFuture, execute_dequeued_workflow
from dbos._error import DBOSBaseException, DBOSWorkflowConflictIDError
from dbos._queue import _INTERNAL_QUEUE_CONSTRUCTION, Queue
from dbos._schemas.system_database import SystemSchema
from dbos._sys_db import SystemDatabase

from app.jobs.engine import prepare_job_tables


def test_version_is_the_one_whose_source_was_read():
    assert importlib.metadata.version("dbos") == "3.4.0"


def test_job_is_put_back_only_from_an_executor_that_still_has_it():
    parameters = list(inspect.signature(SystemDatabase.reenqueue_for_recovery).parameters)
    assert parameters == ["self", "workflow_id", "executor_ids", "recovery_queue_name"]
    assert "status.c.executor_id.in_(executor_ids)" in squeezed(SystemDatabase.reenqueue_for_recovery)


def test_claim_takes_the_lowest_priority_of_one_version_past_what_others_are_taking():
    names = list(inspect.signature(SystemDatabase.start_queued_workflows).parameters)
    assert names[1:6] == [
        "queue", "executor_id", "app_version", "queue_partition_key", "local_running_count"
    ]  # fmt: skip
    assert names[-2:] == ["owner_xid", "is_latest_version"]
    source = squeezed(SystemDatabase.start_queued_workflows)
    assert "order_by(self.tables.workflow_status.c.priority.asc()," in source
    assert "max_tasks,max(0,queue._worker_concurrency-local_running_count)" in source
    assert "skip_locks=nothas_shared_budget" in source
    assert "status.c.application_version==app_version" in source


def test_claimed_workflow_is_begun_with_the_claims_token_and_gives_its_future():
    assert list(inspect.signature(execute_dequeued_workflow).parameters) == ["dbos", "status", "owner_xid"]
    assert "self.future = future" in inspect.getsource(WorkflowHandleFuture)
    assert list(inspect.signature(SystemDatabase.get_workflow_statuses).parameters) == ["self", "workflow_ids"]


def test_queues_that_nobody_listens_to_are_not_claimed_by_dbos_itself():
    assert "queue.name not in listening_set" in inspect.getsource(dbos._queue.queue_thread)
    Queue("q", worker_concurrency=2, token=_INTERNAL_QUEUE_CONSTRUCTION)


def squeezed(function):
    return "".join(inspect.getsource(function).split())


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
