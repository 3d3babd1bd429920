"""Find waiting meals that no job will move, and queue them again or fail them visibly.

The meal's status is the truth; its job may be missing, taken over too often, or have ended without an answer. Each
worker sweeps regularly; `tada doctor --requeue` sweeps at once.
"""

import uuid
from collections.abc import Callable
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.children.faults import INTERNAL_ERROR, JOB_GAVE_UP
from app.db.session import Database
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals.stored.job_models import PairPurpose
from app.meals.stored.models import Meal
from app.meals.stored.queries import WAITING, lock_meal
from app.metrics import instruments

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
    jobs.fail_pair(
        meal, purpose, INTERNAL_ERROR
    )  # its job has ended without an answer, and so would another
    if purpose != "meal":
        settle(session, meal)
    instruments.SWEPT.labels("failed").inc()
    log.error("meal_failed", meal_id=str(meal_id), purpose=purpose, code=INTERNAL_ERROR.code)
    return True
