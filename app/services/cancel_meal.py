"""A meal's estimate is called off before it is made: its jobs end, what waited has failed with the code `cancelled`.

The photographs stay, and a researcher can have the meal estimated after all (retry_meal.py). A worker that has the job
in hand hears of it within a heartbeat or two and ends the child that computes; what it had found is not written.
"""

import uuid
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.db.models import Meal
from app.db.queries import jobs, privacy
from app.db.session import Database
from app.errors import ConflictError
from app.jobs.faults import CANCELLED
from app.services import audit
from app.services.caller import Caller, DeviceCaller
from app.services.locked_meal import lock_meal_of
from app.services.project_records import project_meal
from app.services.read_meal import MealView, read_meal

log = structlog.get_logger()

OF_PAIRS = frozenset({"meal", "after"})  # purposes; the regions that people drew are not a phone's to call off


def cancel_meal(
    database: Database, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> MealView:
    """Call off what of the meal is not measured yet; done before, it changes nothing.

    Raises NotFoundError, NotAllowedError, ConflictError (`nothing_to_cancel`: it is measured, or not complete yet),
    GoneError.
    """
    with database.write() as session:
        locked = lock_meal_of(session, caller, client_id, participant_code)
        called_off = cancel_locked_meal(session, locked.meal, caller)
    log.info("meal_cancelled", meal_id=str(locked.meal.id), jobs=called_off)
    return read_meal(database, caller, client_id, participant_code)


def cancel_locked_meal(session: Session, meal: Meal, caller: Caller | None) -> int:
    """Returns how many jobs were called off. caller None: whoever runs the server. Raises ConflictError."""
    live = privacy.live_jobs_of(session, privacy.one_meal(meal.id))
    if isinstance(caller, DeviceCaller):
        live = [job for job in live if job.purpose in OF_PAIRS]
    if not live:
        if CANCELLED.code in (meal.failure_code, meal.after_failure_code):
            return 0
        raise ConflictError(
            "Nothing of this meal waits for an estimate: it was measured before, or its photographs are not all here.",
            code="nothing_to_cancel",
            meal_status=meal.status,
        )
    now = datetime.now(UTC)
    for job in live:
        jobs.fail_job(job, meal, CANCELLED, now)
    project_meal(session, meal)
    purposes = sorted(job.purpose for job in live)
    audit.note(session, caller, "meal.cancel", study_id=meal.study_id, subject=meal.alias, purposes=purposes)
    return len(live)
