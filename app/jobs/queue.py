"""Queue jobs: rows of our own table, which workers claim (claims.py).

Studies that share workers take turns.

Start-time fair queueing (Goyal, Vin, Cheng: SIGCOMM 1996) with jobs of equal weight: a job's turn
is one more than that of its study's previous job, and at least the turn that workers have reached.
Workers claim the lowest turn first, and the oldest job among equal turns. So a study without a
backlog is next, a study that sends without end gets every other turn beside another such study, and
no study starves. Within a study, jobs run in the order of their arrival.

Background jobs (remeasurements) are outside of this: they have no turn, and workers claim one only
while nothing else waits (claims.py).

A sweep finds waiting meals that no job will move, and queues them again or fails them visibly. The
meal's status is the truth; its job may be missing, taken over too often, or have ended without an
answer. Each worker sweeps regularly; `tada doctor --requeue` sweeps at once.
"""

import threading
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from typing import cast

import structlog
from sqlalchemy.orm import Session

from app.children.faults import INTERNAL_ERROR, JOB_GAVE_UP
from app.db.session import Database
from app.jobs import queries as jobs
from app.meals.stored.job_models import RERUN_OF, Job, JobPurpose, PairPurpose
from app.meals.stored.models import Meal
from app.meals.stored.queries import WAITING, lock_meal
from app.metrics import instruments

# The meaning of a job's row. A job carries the version of the program that queued it, and only workers of that version
# or a higher one run it. Raise the number only if workers of the previous version could not run the new rows.
JOB_PROTOCOL_VERSION = 1


class JobQueue:
    """Queues jobs and assigns their turns; one per process.

    The process remembers the turns that it has assigned: concurrent uploads of a study do not see
    each other's uncommitted rows, and would all get the same turn. Several processes may still
    assign the same turn once each.
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

        A job that has a turn keeps it; a background job has none. The job also gets the current
        request's id, which its worker logs.
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


log = structlog.get_logger()

Settle = Callable[[Session, Meal], object]  # EstimateUseCases.settle


def sweep(database: Database, queue: JobQueue, settle: Settle) -> int:
    """Move every stuck meal, each in its own transaction. Returns their number."""
    with database.read() as session:
        exhausted = jobs.exhausted_jobs(session)
        orphans = jobs.waiting_without_live_job(session)
    moved = 0
    for job_id in exhausted:
        with database.write() as session:
            moved += _give_up(session, job_id, settle)
    for meal_id, purpose in orphans:
        with database.write() as session:
            moved += _move_meal(session, queue, meal_id, purpose, settle)
    return moved


def _give_up(session: Session, job_id: uuid.UUID, settle: Settle) -> bool:
    live = jobs.lock_live_job(session, job_id)
    if live is None:
        return False
    job, meal = live
    jobs.fail_job(job, meal, JOB_GAVE_UP, datetime.now(UTC))
    if job.purpose != "meal":
        settle(session, meal)
    instruments.SWEPT.labels("failed").inc()
    log.error("job_failed", job_id=str(job_id), meal_id=str(meal.id), code=JOB_GAVE_UP.code)
    return True


def _move_meal(
    session: Session, queue: JobQueue, meal_id: uuid.UUID, purpose: PairPurpose, settle: Settle
) -> bool:
    meal = lock_meal(session, meal_id)
    if meal is None or jobs.pair_status(meal, purpose) not in WAITING:
        return False
    count, live = jobs.count_jobs(session, meal_id, purpose)
    if live:
        return False
    if not count:
        jobs.advance_pair(meal, purpose, "queued")
        queue.enqueue_pair(session, meal, purpose)
        instruments.SWEPT.labels("queued").inc()
        log.warning(
            "meal_queued_again", meal_id=str(meal_id), purpose=purpose, reason="it had no job"
        )
        return True
    # its job has ended without an answer, and so would another
    jobs.fail_pair(meal, purpose, INTERNAL_ERROR)
    if purpose != "meal":
        settle(session, meal)
    instruments.SWEPT.labels("failed").inc()
    log.error("meal_failed", meal_id=str(meal_id), purpose=purpose, code=INTERNAL_ERROR.code)
    return True
