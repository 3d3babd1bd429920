"""Queue jobs: rows of our own table, which workers claim (claims.py). Studies that share workers take turns.

Start-time fair queueing (Goyal, Vin, Cheng: SIGCOMM 1996) with jobs of equal weight: a job's turn is one more than that
of its study's previous job, and at least the turn that workers have reached. Workers claim the lowest turn first, and
the oldest job among equal turns. So a study without a backlog is next, a study that sends without end gets every other
turn beside another such study, and no study starves. Within a study, jobs run in the order of their arrival.

Background jobs (remeasurements) are outside of this: they have no turn, and workers claim one only while nothing else
waits (claims.py).
"""

import threading
import uuid
from datetime import UTC, datetime
from typing import cast

import structlog
from sqlalchemy.orm import Session

from app.jobs import queries as jobs
from app.meals.stored.job_models import RERUN_OF, Job, JobPurpose, PairPurpose
from app.meals.stored.models import Meal

# The meaning of a job's row. A job carries the version of the program that queued it, and only workers of that version
# or a higher one run it. Raise the number only if workers of the previous version could not run the new rows.
JOB_PROTOCOL_VERSION = 1


class JobQueue:
    """Queues jobs and assigns their turns; one per process.

    The process remembers the turns that it has assigned: concurrent uploads of a study do not see each other's
    uncommitted rows, and would all get the same turn. Several processes may still assign the same turn once each.
    """

    def __init__(self, *, protocol: int | None = None) -> None:
        self._protocol = JOB_PROTOCOL_VERSION if protocol is None else protocol
        self._assigned: dict[uuid.UUID, int] = {}  # study -> its highest turn
        self._lock = threading.Lock()

    def enqueue_pair(self, session: Session, meal: Meal, purpose: PairPurpose) -> Job:
        """Queue the estimate of a meal's pair, or of its after-meal pair."""
        job = Job(
            id=uuid.uuid4(),
            meal_id=meal.id,
            purpose=purpose,
            state="queued",
            attempts=0,
            enqueued_at=datetime.now(UTC),
        )
        self.enqueue(session, job)
        return job

    def enqueue_rerun(self, session: Session, meal_id: uuid.UUID, pair: PairPurpose) -> Job:
        """Queue a pair's estimate by a remeasurement, in the background."""
        purpose = cast(
            "JobPurpose", next(purpose for purpose, of_pair in RERUN_OF.items() if of_pair == pair)
        )
        job = Job(
            id=uuid.uuid4(),
            meal_id=meal_id,
            purpose=purpose,
            is_background=True,
            state="queued",
            attempts=0,
            turn=0,
            enqueued_at=datetime.now(UTC),
        )
        self.enqueue(session, job)
        return job

    def enqueue(self, session: Session, job: Job) -> None:
        """Add the job to the session; it runs, at its turn, once the transaction is committed.

        A job that has a turn keeps it; a background job has none. The job also gets the current request's id, which its
        worker logs.
        """
        if not job.turn and not job.is_background:
            job.study_id = session.get_one(Meal, job.meal_id).study_id
            job.turn = self._next_turn(session, job.study_id)
        job.protocol = self._protocol
        job.request_id = structlog.contextvars.get_contextvars().get("request_id")
        session.add(job)
        session.flush()

    def _next_turn(self, session: Session, study_id: uuid.UUID) -> int:
        reached, last_of_study = jobs.turns_so_far(session, study_id)
        with self._lock:
            turn = max(reached, last_of_study + 1, self._assigned.get(study_id, 0) + 1)
            self._assigned[study_id] = turn
        return turn
