"""A meal that failed is estimated again: a new job and a new run on the photographs that are kept.

Only what has failed is done again, the meal's pair or its after-meal pair; a meal that was measured, or that a person
has settled, is never moved by it. Which failures are worth another try is for whoever asks: after a fault of the server
(internal_error, job_gave_up, estimate_timed_out, ...) all of them, after an upgrade of the pipeline perhaps
marker_not_found too. A retried meal stands at the end of its study's line, as a new one does.
"""

import uuid
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, GoneError
from app.db.session import Database
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals import queries as meals
from app.meals.job_models import Job
from app.meals.models import AFTER_SLOTS, SLOTS, Meal
from app.people import privacy_queries as people_privacy
from app.people.access import audit
from app.people.access.caller import Caller
from app.people.participants import has_left
from app.records.locked_meal import lock_meal_of
from app.records.project_records import project_meal
from app.records.read_meal import MealView, read_meal

log = structlog.get_logger()


def retry_meal(
    database: Database, queue: JobQueue, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> tuple[MealView, bool]:
    """The meal as it stands with its new job, and whether there is one: a second call while it waits changes nothing.

    Raises NotFoundError, NotAllowedError, ConflictError (`nothing_to_retry`), GoneError (`photograph_erased`,
    `withdrawn`).
    """
    with database.write() as session:
        locked = lock_meal_of(session, caller, client_id, participant_code)
        queued = retry_locked_meal(session, queue, locked.meal, caller)
    log.info("meal_retried", meal_id=str(locked.meal.id), purposes=queued)
    return read_meal(database, caller, client_id, participant_code), bool(queued)


def retry_locked_meal(
    session: Session, queue: JobQueue, meal: Meal, caller: Caller | None, *, code: str | None = None
) -> list[str]:
    """Purposes of the jobs that were queued. caller None: whoever runs the server. code: only what failed with it.

    Raises ConflictError, GoneError.
    """
    participant = people_privacy.join_participant(session, meal.participant_id)
    if participant is None or participant.withdrawn_at is not None:
        raise has_left()
    failed = _what_failed(meal, code)
    if not failed:
        if jobs.live_jobs_of(session, jobs.one_meal(meal.id)):
            return []
        raise ConflictError(
            "Nothing of this meal has failed: what was measured is not measured again by a retry.",
            code="nothing_to_retry",
            meal_status=meal.status,
        )
    there = {image.slot for image in meals.images_of(session, meal.id) if image.erased_at is None}
    wanted = [purpose for purpose, slots in failed.items() if there.issuperset(slots)]
    if not wanted:
        raise GoneError("The photographs of this meal were erased.", code="photograph_erased")
    for purpose in wanted:
        _queue_again(session, queue, meal, purpose)
    project_meal(session, meal)
    audit.note(session, caller, "meal.retry", study_id=meal.study_id, subject=meal.alias, purposes=wanted)
    return wanted


def _what_failed(meal: Meal, code: str | None) -> dict[str, tuple[str, ...]]:
    """Purpose -> the photographs that it needs."""
    failed: dict[str, tuple[str, ...]] = {}
    if meal.status == "failed" and meal.origin == "photographed" and code in (None, meal.failure_code):
        failed["meal"] = SLOTS
    if meal.after_status == "failed" and code in (None, meal.after_failure_code):
        failed["after"] = AFTER_SLOTS
    return failed


def _queue_again(session: Session, queue: JobQueue, meal: Meal, purpose: str) -> None:
    now = datetime.now(UTC)
    job = Job(id=uuid.uuid4(), meal_id=meal.id, purpose=purpose, state="queued", attempts=0, enqueued_at=now)
    if purpose == "meal":
        meal.status, meal.stage = "queued", None
        meal.failure_code = meal.failure_message = meal.failure_advice = None
    else:
        meal.after_status = "queued"
        meal.after_failure_code = meal.after_failure_message = meal.after_failure_advice = None
    queue.enqueue(session, job)
