"""The use cases of `tada jobs` for operators: list live jobs and failed pairs, retry them, cancel them.

The rules are those of the calls (cancel_meal.py, retry_meal.py). Here meals are selected and handled one by one, each
in its own transaction, so that thousands of them block nobody.
"""

import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, GoneError, NotFoundError
from app.db.session import Database, despite_deadlocks
from app.jobs.queue import JobQueue
from app.meals.estimate.retry_meal import retry_locked_meal
from app.meals.stored import queries as meals
from app.meals.stored.models import Meal
from app.meals.upload import job_list_queries as job_lists
from app.meals.upload.cancel_meal import cancel_locked_meal
from app.meals.upload.job_list_queries import FailedFilter, JobRow
from app.people import queries as people
from app.records.read_meal import lock_with_person

BATCH = 100  # ids read at once; each meal has its own transaction


@dataclass(slots=True)
class Retried:
    """queued: number of meals. left: code -> number of meals that could not be queued (erased, or already retried)."""

    queued: int = 0
    left: Counter[str] = field(default_factory=Counter)


def waiting_jobs(database: Database, *, study_code: str | None, limit: int) -> list[JobRow]:
    """Return live jobs in their order. Raises NotFoundError for an unknown study."""
    with database.read() as session:
        _require_study(session, study_code)
        return job_lists.list_live_jobs(session, study_code, limit)


def failed_pairs(database: Database, failures: FailedFilter, *, limit: int) -> list[JobRow]:
    """Return failed pairs, the latest first. Raises NotFoundError for an unknown study."""
    with database.read() as session:
        _require_study(session, failures.study_code)
        return job_lists.list_failed(session, failures, limit)


def retry_named(
    database: Database, queue: JobQueue, client_id: uuid.UUID, participant_code: str | None
) -> bool:
    """Retry one meal. Returns False if it waits already.

    Raises NotFoundError, ConflictError (`meal_id_ambiguous`, `nothing_to_retry`), GoneError.
    """
    with database.write() as session:
        return bool(
            retry_locked_meal(session, queue, _locked(session, client_id, participant_code), None)
        )


def retry_failed(database: Database, queue: JobQueue, failures: FailedFilter) -> Retried:
    """Retry all pairs that the filters select, but no other pair of those meals.

    Raises NotFoundError for an unknown study.
    """
    done = Retried()
    with database.read() as session:
        _require_study(session, failures.study_code)

    def retry(session: Session, meal: Meal) -> None:
        try:
            done.queued += bool(retry_locked_meal(session, queue, meal, None, code=failures.code))
        except (ConflictError, GoneError) as error:
            done.left[error.code] += 1

    _for_each_failed_meal(database, failures, retry)
    return done


def cancel_named(database: Database, client_id: uuid.UUID, participant_code: str | None) -> bool:
    """Cancel one meal's estimates. Returns False if they were cancelled before.

    Raises NotFoundError, ConflictError (`meal_id_ambiguous`, `nothing_to_cancel`).
    """
    with database.write() as session:
        return bool(
            cancel_locked_meal(session, _locked(session, client_id, participant_code), None)
        )


def _for_each_failed_meal(
    database: Database, failures: FailedFilter, do: Callable[[Session, Meal], None]
) -> None:
    after = None
    while True:
        with database.read() as session:
            batch = job_lists.failed_meals(session, failures, after, BATCH)
        for meal_id in batch:
            _in_own_transaction(database, meal_id, do)
        if len(batch) < BATCH:
            return
        after = batch[-1]


def _in_own_transaction(
    database: Database, meal_id: uuid.UUID, do: Callable[[Session, Meal], None]
) -> None:
    """Retry the transaction if PostgreSQL ended it by a deadlock.

    Here a participant is locked before the meal, but saving an estimate locks the meal first.
    """

    def transaction() -> None:
        with database.write() as session:
            meal = session.get(Meal, meal_id)
            locked = lock_with_person(session, meal) if meal is not None else None
            if locked is not None:  # otherwise erased meanwhile
                do(session, locked)

    despite_deadlocks(transaction)


def _locked(session: Session, client_id: uuid.UUID, participant_code: str | None) -> Meal:
    matches = meals.find_meals(
        session, client_id, participant_id=None, participant_code=participant_code, study_ids=None
    )
    if len(matches) > 1:
        raise ConflictError(
            "More than one participant has a meal of this id: add --participant CODE.",
            code="meal_id_ambiguous",
        )
    meal = lock_with_person(session, matches[0][0]) if matches else None
    if meal is None:
        raise NotFoundError(f"There is no meal {client_id}.")
    return meal


def _require_study(session: Session, code: str | None) -> None:
    if code is not None and people.find_study(session, code) is None:
        raise NotFoundError(f"There is no study {code!r}.")
