"""Claims jobs for one worker: never more than it has room for, and the next one as soon as a child is free.

In place of DBOS's own queue thread, which knows one concurrency for all workers of a database, looks only every so
often, and runs rows of one version. The claim itself is DBOS's: one statement that takes the rows of the lowest turn,
past those that another worker is just taking. What is private there is in the contract test.
"""

import random
import threading
import uuid
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any

import structlog
from dbos import DBOS
from dbos._core import WorkflowHandleFuture, execute_dequeued_workflow
from dbos._queue import _INTERNAL_QUEUE_CONSTRUCTION, Queue

log = structlog.get_logger()

POLL_SECONDS = 0.25  # how long a meal waits for an idle worker to look
STOP_SECONDS = 5.0  # for a claim under way to end


class Claims:
    """One a worker process. versions: of jobs that this program can run."""

    def __init__(
        self, dbos: DBOS, queue_name: str, executor_id: str, *, concurrency: int, versions: Sequence[str]
    ) -> None:
        self._dbos = dbos
        self._executor_id = executor_id
        self._concurrency = concurrency
        self._versions = list(versions)
        self._queue = Queue(queue_name, worker_concurrency=concurrency, token=_INTERNAL_QUEUE_CONSTRUCTION)
        self._claimed: set[str] = set()
        self._computed: set[str] = set()  # of those: only what is to be sealed and saved is left
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._look = threading.Event()
        self._thread = threading.Thread(target=self._claim_on_and_on, name="claims", daemon=True)

    def start(self) -> None:
        """Begin to claim."""
        self._thread.start()

    def stop(self) -> None:
        """Claim no further job; those that were claimed go on."""
        self._ending.set()
        self._look.set()
        self._thread.join(STOP_SECONDS)

    def note_computed(self, workflow_id: str) -> None:
        """The job needs no child any more: while its result is sealed and saved, the next one may have it."""
        with self._lock:
            if workflow_id in self._claimed:
                self._computed.add(workflow_id)
        self._look.set()

    def note_computing(self, workflow_id: str) -> None:
        """The job needs a child, maybe again: what it had found could not be sealed."""
        with self._lock:
            self._computed.discard(workflow_id)

    def _claim_on_and_on(self) -> None:
        while not self._ending.is_set():
            self._look.clear()
            try:
                self._claim_what_there_is_room_for()
            except Exception as error:  # the worker's edge: the database comes back
                if not self._ending.is_set():
                    log.warning("claim_failed", exc_info=error)
            self._look.wait(POLL_SECONDS * random.uniform(0.9, 1.1))  # noqa: S311  # workers should not look in step

    def _claim_what_there_is_room_for(self) -> None:
        # while jobs of two versions wait, as in a rolling upgrade, neither always goes first
        for version in random.sample(self._versions, len(self._versions)):
            with self._lock:
                claimed, computed = len(self._claimed), len(self._computed)
            running = claimed - min(computed, self._concurrency)  # a store that is slow piles up no results
            if running >= self._concurrency or self._ending.is_set():
                return
            token = str(uuid.uuid4())
            ids, _ = self._dbos._sys_db.start_queued_workflows(  # noqa: SLF001
                self._queue, self._executor_id, version, None, running, owner_xid=token, is_latest_version=False
            )
            with self._lock:
                self._claimed.update(ids)
            self._begin(ids, token)

    def _begin(self, ids: Sequence[str], token: str) -> None:
        """Start what was claimed. What cannot be started is found by whoever looks for lost jobs, and queued again."""
        found = {}
        try:
            if ids:
                statuses = self._dbos._sys_db.get_workflow_statuses(list(ids))  # noqa: SLF001
                found = {status["workflow_uuid"]: status for status in statuses}
        finally:
            for lost in set(ids) - found.keys():
                self._let_go(lost)
        for workflow_id in ids:
            future: Future[Any] | None = None
            try:
                if workflow_id in found:
                    handle = execute_dequeued_workflow(self._dbos, found[workflow_id], token)
                    future = handle.future if isinstance(handle, WorkflowHandleFuture) else None
            except Exception as error:  # noqa: BLE001  # a job that was given up says so by an exception
                log.warning("job_not_begun", job_id=workflow_id, reason=f"{type(error).__name__}: {error}")
            if future is None:
                self._let_go(workflow_id)
            else:
                future.add_done_callback(lambda _, ended=workflow_id: self._let_go(ended))  # type: ignore[misc]

    def _let_go(self, workflow_id: str) -> None:
        """There is room again: look at once."""
        with self._lock:
            self._claimed.discard(workflow_id)
            self._computed.discard(workflow_id)
        self._look.set()
