"""SQL of the lists for operators of jobs: live jobs, and failed pairs."""

import uuid
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session, aliased

from app.meals.stored.job_models import LIVE_STATES, Job
from app.meals.stored.models import Meal
from app.people.models import Participant, Study

_PAIRS = (
    ("meal", Meal.status, Meal.failure_code),
    ("after", Meal.after_status, Meal.after_failure_code),
)


@dataclass(frozen=True, slots=True)
class JobRow:
    """A live job or a failed pair, as `tada jobs list` prints it. meal: the id that its phone made.

    code: the failure's. since: when it was queued, or for a failure, ended. worker, attempts: of the pair's last job.
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
