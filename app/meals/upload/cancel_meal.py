"""Cancel a meal's estimate before it is made: its jobs end, and waiting pairs fail with the code `cancelled`.

The photographs are kept, and a researcher can have the meal estimated after all (retry_meal.py). A worker that runs the
job notices within two heartbeats and ends its child; the result is not saved.
"""

import uuid
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.children.faults import CANCELLED
from app.core.errors import ConflictError
from app.db.session import Database
from app.jobs import queries as jobs
from app.meals.stored.models import Meal
from app.meals.stored.queries import WAITING
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller
from app.records.project_records import project_meal
from app.records.read_meal import MealView, lock_meal_of, read_meal

log = structlog.get_logger()

PHONE_PURPOSES = frozenset(
    {"meal", "after"}
)  # a phone cannot cancel the measuring of redrawn regions


def cancel_meal(
    database: Database, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> MealView:
    """Cancel the unfinished estimates of the meal; repeated, it changes nothing.

    Raises NotFoundError, NotAllowedError, ConflictError (`nothing_to_cancel`: it is estimated, or not complete yet),
    GoneError.
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
    lost = [] if live else _waiting_pairs(meal)
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


def _waiting_pairs(meal: Meal) -> list[str]:
    """Return the waiting pairs of a meal that has no live job: a sweep would queue one (jobs/sweep.py)."""
    statuses = {"meal": meal.status, "after": meal.after_status}
    return [purpose for purpose, status in statuses.items() if status in WAITING]


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
