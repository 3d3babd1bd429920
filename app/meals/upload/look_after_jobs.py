"""The use cases of `tada jobs` for operators: list live jobs and failed pairs, retry them, cancel them.

The rules are those of the calls (cancel_or_retry.py). Here meals are selected and handled one by
one, each in its own transaction, so that thousands of them block nobody.
"""

import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session, aliased

from app.core.errors import ConflictError, GoneError, NotFoundError
from app.db.session import Database, despite_deadlocks
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.job_models import LIVE_STATES, Job
from app.meals.stored.models import Meal
from app.meals.upload.cancel_or_retry import cancel_locked_meal, retry_locked_meal
from app.people import queries as people
from app.people.models import Participant, Study
from app.records.read_meal import lock_with_person

_PAIRS = (
    ("meal", Meal.status, Meal.failure_code),
    ("after", Meal.after_status, Meal.after_failure_code),
)


@dataclass(frozen=True, slots=True)
class JobRow:
    """A live job or a failed pair, as `tada jobs list` prints it. meal: the id that its phone made.

    code: the failure's
    since: when it was queued, or for a failure, ended
    worker, attempts: of the pair's last job
    """

    study: str
    participant: str
    meal: uuid.UUID
    purpose: str
    state: str
    since: datetime | None
    code: str | None
    attempts: int
    worker: str | None


@dataclass(frozen=True, slots=True)
class FailedFilter:
    """Filters of failed pairs; None: not filtered. since: their last job ended then or later."""

    study_code: str | None = None
    code: str | None = None
    since: datetime | None = None


def list_live_jobs(session: Session, study_code: str | None, limit: int) -> list[JobRow]:
    """Return live jobs: first those in progress, then the others in the order of their turns."""
    query = (
        sa.select(Study.code, Participant.code, Meal.client_id, Job)
        .join(Meal, Meal.id == Job.meal_id)
        .join(Study, Study.id == Meal.study_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(Job.state.in_(LIVE_STATES))
        .order_by(Job.state == "queued", Job.is_background, Job.turn, Job.enqueued_at, Job.id)
        .limit(limit)
    )
    if study_code is not None:
        query = query.where(Study.code == study_code)
    return [
        JobRow(
            study,
            person,
            meal,
            job.purpose,
            job.state,
            job.enqueued_at,
            None,
            job.attempts,
            job.executor_id,
        )
        for study, person, meal, job in session.execute(query)
    ]


def list_failed(session: Session, failures: FailedFilter, limit: int) -> list[JobRow]:
    """Return failed pairs, the latest first; pairs without a job, whose time is unknown, come last."""
    rows: list[JobRow] = []
    for purpose, _, code in _PAIRS:
        last = _last_job(purpose)
        query = (
            sa.select(Study.code, Participant.code, Meal.client_id, code, Job)
            .join(Study, Study.id == Meal.study_id)
            .join(Participant, Participant.id == Meal.participant_id)
            .outerjoin(Job, Job.id == last)
            .where(_has_failed(purpose, failures))
            .order_by(Job.finished_at.desc().nulls_last(), Meal.client_id, Meal.id)
            .limit(limit)
        )
        for study, person, meal, failure, job in session.execute(query):
            at, attempts, worker = (
                (job.finished_at, job.attempts, job.executor_id) if job else (None, 0, None)
            )
            rows.append(
                JobRow(study, person, meal, purpose, "failed", at, failure, attempts, worker)
            )
    rows.sort(key=_last_first)
    return rows[:limit]


def _last_first(row: JobRow) -> tuple[bool, float, uuid.UUID]:
    """Sort key in the order of the queries, the same for every database."""
    return row.since is None, -row.since.timestamp() if row.since is not None else 0.0, row.meal


def failed_meals(
    session: Session, failures: FailedFilter, after: uuid.UUID | None, limit: int
) -> list[uuid.UUID]:
    """Return meals with a failed pair, ordered by id, after the id `after`."""
    has_failed = sa.or_(*(_has_failed(purpose, failures) for purpose, _, _ in _PAIRS))
    query = sa.select(Meal.id).where(has_failed).order_by(Meal.id).limit(limit)
    if after is not None:
        query = query.where(Meal.id > after)
    return list(session.scalars(query))


def _last_job(purpose: str) -> sa.ScalarSelect[uuid.UUID]:
    other = aliased(Job)
    return (
        sa.select(other.id)
        .where(other.meal_id == Meal.id, other.purpose == purpose)
        .order_by(other.enqueued_at.desc(), other.id)
        .limit(1)
        .scalar_subquery()
    )


def _has_failed(purpose: str, failures: FailedFilter) -> sa.ColumnElement[bool]:
    status, code = next((status, code) for name, status, code in _PAIRS if name == purpose)
    conditions = [status == "failed"]
    if failures.code is not None:
        conditions.append(code == failures.code)
    if failures.study_code is not None:
        conditions.append(
            Meal.study_id.in_(sa.select(Study.id).where(Study.code == failures.study_code))
        )
    if failures.since is not None:
        ended = sa.exists().where(
            Job.meal_id == Meal.id, Job.purpose == purpose, Job.finished_at >= failures.since
        )
        conditions.append(ended)
    return sa.and_(*conditions)


BATCH = 100  # ids read at once; each meal has its own transaction


@dataclass(slots=True)
class Retried:
    """queued: number of meals.

    left: code -> number of meals that could not be queued (erased, or already retried).
    """

    queued: int = 0
    left: Counter[str] = field(default_factory=Counter)


def waiting_jobs(database: Database, *, study_code: str | None, limit: int) -> list[JobRow]:
    """Return live jobs in their order. Raises NotFoundError for an unknown study."""
    with database.read() as session:
        _require_study(session, study_code)
        return list_live_jobs(session, study_code, limit)


def failed_pairs(database: Database, failures: FailedFilter, *, limit: int) -> list[JobRow]:
    """Return failed pairs, the latest first. Raises NotFoundError for an unknown study."""
    with database.read() as session:
        _require_study(session, failures.study_code)
        return list_failed(session, failures, limit)


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
            batch = failed_meals(session, failures, after, BATCH)
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
