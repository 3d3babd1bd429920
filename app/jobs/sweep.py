"""Finds meals that wait for something that will never happen, and queues them again or fails them visibly.

The meal's status in our tables is the truth; a workflow may be missing, dead-lettered, cancelled or ended by a bug.
Each worker sweeps now and then; `tada doctor --requeue` does it at once.
"""

import uuid
from collections.abc import Callable
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.db.models import Job, Meal
from app.db.queries import jobs
from app.db.queries.meals import WAITING, lock_meal
from app.db.session import Database
from app.jobs.engine import JobQueue
from app.jobs.faults import CANCELLED, INTERNAL_ERROR, JOB_GAVE_UP
from app.metrics import instruments

log = structlog.get_logger()

Settle = Callable[[Session, Meal], object]  # EstimateUseCases.settle

FAILURES = {"MAX_RECOVERY_ATTEMPTS_EXCEEDED": JOB_GAVE_UP, "CANCELLED": CANCELLED}  # by DBOS's words; else a bug


def sweep(database: Database, queue: JobQueue, settle: Settle) -> int:
    """Move every stuck meal, each in its own transaction. Returns how many there were."""
    with database.read() as session:
        stuck = jobs.stuck_jobs(session)
        orphans = jobs.waiting_without_live_job(session)
    moved = 0
    for job_id in stuck:
        with database.write() as session:
            moved += _move_job(session, queue, job_id, settle)
    for meal_id, purpose in orphans:
        with database.write() as session:
            moved += _move_meal(session, queue, meal_id, purpose, settle)
    return moved


def _move_job(session: Session, queue: JobQueue, job_id: uuid.UUID, settle: Settle) -> bool:
    found = jobs.lock_live_job(session, job_id)
    if found is None:
        return False
    job, meal = found
    status = jobs.workflow_status(session, job_id)
    if status in jobs.MOVING_STATUSES:
        return False
    if status is None:
        job.state = "queued"
        queue.enqueue(session, job)
        instruments.SWEPT.labels("queued").inc()
        log.warning("job_queued_again", job_id=str(job_id), meal_id=str(meal.id), reason="it had no workflow")
        return True
    failure = FAILURES.get(status, INTERNAL_ERROR)
    jobs.fail_job(job, meal, failure, datetime.now(UTC))
    if job.purpose != "meal":
        settle(session, meal)
    instruments.SWEPT.labels("failed").inc()
    log.error("job_failed", job_id=str(job_id), meal_id=str(meal.id), code=failure.code, workflow_status=status)
    return True


def _move_meal(session: Session, queue: JobQueue, meal_id: uuid.UUID, purpose: str, settle: Settle) -> bool:
    meal = lock_meal(session, meal_id)
    if meal is None or (meal.status if purpose == "meal" else meal.after_status) not in WAITING:
        return False
    made, live = jobs.count_jobs(session, meal_id, purpose)
    if live:
        return False
    if not made:
        _queue_first_job(session, queue, meal, purpose)
        instruments.SWEPT.labels("queued").inc()
        log.warning("meal_queued_again", meal_id=str(meal_id), purpose=purpose, reason="it had no job")
        return True
    if purpose == "meal":  # its job is finished and left it waiting: another would do the same
        jobs.fail_meal(meal, INTERNAL_ERROR)
    else:
        jobs.fail_after_pair(meal, INTERNAL_ERROR)
        settle(session, meal)
    instruments.SWEPT.labels("failed").inc()
    log.error("meal_failed", meal_id=str(meal_id), purpose=purpose, code=INTERNAL_ERROR.code)
    return True


def _queue_first_job(session: Session, queue: JobQueue, meal: Meal, purpose: str) -> None:
    now = datetime.now(UTC)
    job = Job(id=uuid.uuid4(), meal_id=meal.id, purpose=purpose, state="queued", attempts=0, enqueued_at=now)
    if purpose == "meal" and meal.status != "queued":
        meal.status, meal.stage = "queued", None
        meal.version += 1
    elif purpose == "after" and meal.after_status != "queued":
        meal.after_status = "queued"
        meal.version += 1
    queue.enqueue(session, job)
