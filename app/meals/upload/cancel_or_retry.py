"""Cancel a meal's estimate before it is made, or have a failed meal estimated again.

Cancelled, its jobs end, and waiting pairs fail with the code `cancelled`. The photographs are kept,
and a researcher can have the meal estimated after all. A worker that runs the job notices within
two heartbeats and ends its child; the result is not saved.

A retry is a new job and a new run on the stored photographs of a failed pair, the meal's own or the
after-meal pair; a meal that was measured, or that a person has settled, never changes. The caller
decides which failures are worth a retry: after a fault of the server (internal_error, job_gave_up,
estimate_timed_out, ...) all of them, after an upgrade of the pipeline perhaps marker_not_found too.
A retried meal goes to the end of its study's queue, like a new one.
"""

import uuid
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.children.faults import CANCELLED
from app.core.errors import ConflictError, GoneError
from app.db.session import Database
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.job_models import PAIRS, PairPurpose
from app.meals.stored.models import Meal
from app.meals.stored.queries import WAITING
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller
from app.people.participants import require_in_study
from app.records.project_records import project_meal
from app.records.read_meal import MealView, lock_meal_of, read_meal

log = structlog.get_logger()

# a phone cannot cancel the measuring of redrawn regions
PHONE_PURPOSES = frozenset({"meal", "after"})


def cancel_meal(
    database: Database, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> MealView:
    """Cancel the unfinished estimates of the meal; repeated, it changes nothing.

    Raises NotFoundError, NotAllowedError, ConflictError (`nothing_to_cancel`: it is estimated, or
    not complete yet), GoneError.
    """
    with database.write() as session:
        meal, _, _ = lock_meal_of(session, caller, client_id, participant_code)
        cancelled = cancel_locked_meal(session, meal, caller)
    log.info("meal_cancelled", meal_id=str(meal.id), jobs=cancelled)
    return read_meal(database, caller, client_id, participant_code)


def cancel_locked_meal(session: Session, meal: Meal, caller: Caller | None) -> int:
    """Return the number of cancelled jobs, and of pairs whose job was lost. Raises ConflictError.

    caller None: an operator.
    """
    live = jobs.live_jobs_of(session, jobs.one_meal(meal.id))
    if isinstance(caller, DeviceCaller):
        live = [job for job in live if job.purpose in PHONE_PURPOSES]
    # a sweep would queue a job for these (jobs/queue.py)
    waiting = [purpose for purpose in PAIRS if meal.pair(purpose).status in WAITING]
    lost = [] if live else waiting
    if not live and not lost:
        if CANCELLED.code in (meal.failure_code, meal.after_failure_code):
            return 0
        raise _nothing_waits(meal)
    now = datetime.now(UTC)
    for job in live:
        jobs.fail_job(job, meal, CANCELLED, now)
    for purpose in lost:
        jobs.fail_pair(meal, purpose, CANCELLED)
    project_meal(session, meal)
    purposes = sorted([*(job.purpose for job in live), *lost])
    audit.note(
        session,
        caller,
        "meal.cancel",
        study_id=meal.study_id,
        subject=meal.alias,
        purposes=purposes,
    )
    return len(purposes)


def _nothing_waits(meal: Meal) -> ConflictError:
    if meal.status == "failed":
        reason, facts = (
            f"it has already failed ({meal.failure_code})",
            {"failure_code": meal.failure_code},
        )
    elif meal.status == "receiving":
        reason, facts = "not all of its photographs have arrived", {}
    elif meal.origin == "declared":
        reason, facts = "it was entered without photographs", {}
    else:
        reason, facts = "it has been estimated", {}
    return ConflictError(
        f"Nothing of this meal waits for an estimate: {reason}.",
        code="nothing_to_cancel",
        meal_status=meal.status,
        **facts,
    )


def retry_meal(
    database: Database,
    queue: JobQueue,
    caller: Caller,
    client_id: uuid.UUID,
    participant_code: str | None = None,
) -> tuple[MealView, bool]:
    """Return the meal, and whether a job was queued: a second call while the meal waits changes nothing.

    Raises NotFoundError, NotAllowedError, ConflictError (`nothing_to_retry`), GoneError
    (`photograph_erased`, `withdrawn`).
    """
    with database.write() as session:
        meal, _, _ = lock_meal_of(session, caller, client_id, participant_code)
        queued = retry_locked_meal(session, queue, meal, caller)
    log.info("meal_retried", meal_id=str(meal.id), purposes=queued)
    return read_meal(database, caller, client_id, participant_code), bool(queued)


def retry_locked_meal(
    session: Session, queue: JobQueue, meal: Meal, caller: Caller | None, *, code: str | None = None
) -> list[PairPurpose]:
    """Return the purposes of the queued jobs.

    caller None: an operator
    code: retry only failures with this code

    Raises ConflictError, GoneError.
    """
    require_in_study(session, meal.participant_id)
    failed = [purpose for purpose in PAIRS if _has_failed(meal, purpose, code)]
    if not failed:
        if jobs.live_jobs_of(session, jobs.one_meal(meal.id)):
            return []
        raise ConflictError(
            "Nothing of this meal has failed: a retry does not measure again what was measured.",
            code="nothing_to_retry",
            meal_status=meal.status,
        )
    stored = {image.slot for image in meals.images_of(session, meal.id) if image.erased_at is None}
    purposes = [purpose for purpose in failed if stored.issuperset(meal.pair(purpose).slots)]
    if not purposes:
        raise GoneError("The photographs of this meal were erased.", code="photograph_erased")
    for purpose in purposes:
        meal.pair(purpose).set_status("queued")
        meal.pair(purpose).set_failure(None)
        queue.enqueue_pair(session, meal, purpose)
    project_meal(session, meal)
    audit.note(
        session, caller, "meal.retry", study_id=meal.study_id, subject=meal.alias, purposes=purposes
    )
    return purposes


def _has_failed(meal: Meal, purpose: PairPurpose, code: str | None) -> bool:
    pair = meal.pair(purpose)
    is_failed = pair.status == "failed" and code in (None, pair.failure_code)
    return is_failed and meal.origin == "photographed"
