"""Where the API leaves jobs: rows of our own table, which workers claim (claims.py)."""

import structlog
from sqlalchemy.orm import Session

from app.jobs.turns import Turns
from app.meals.job_models import Job

# What a job's row means. A job is queued with the number of whoever queues it, and run by workers of that number or a
# higher one: it changes only when workers of the version before could not run the new rows.
JOB_PROTOCOL_VERSION = 1


class JobQueue:
    """One per process."""

    def __init__(self, *, protocol: int | None = None) -> None:
        self._protocol = JOB_PROTOCOL_VERSION if protocol is None else protocol
        self._turns = Turns()

    def enqueue(self, session: Session, job: Job) -> None:
        """Make the job run, at its turn, once the session's transaction is committed; rolled back, it never was.

        The id of the request that we are in goes with it, so that the worker's log names it too.
        """
        self._turns.give(session, job)
        job.protocol = self._protocol
        job.request_id = structlog.contextvars.get_contextvars().get("request_id")
        session.add(job)
        session.flush()
