"""SQL of jobs, which are the workers' queue, and how long a worker waits for what."""

import uuid
from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Session, object_session

from app.core.errors import Failure
from app.meals.stored.announce import announce_meal
from app.meals.stored.job_models import (
    LIVE_STATES,
    PAIRS,
    RERUN_OF,
    Job,
    PairPurpose,
    RemeasuredPair,
)
from app.meals.stored.models import Meal
from app.meals.stored.queries import WAITING

# How often a job is taken over from dead workers before its meal fails. Generous: a photograph can kill its child but
# not the worker, so a worker's death says something about the machine, not about its jobs.
MAX_TAKEOVERS = 25
LONGEST_PUT_OFF = timedelta(minutes=1)  # a clock that was ahead wrote a later time; it is ignored


@dataclass(frozen=True, slots=True)
class WorkerTimes:
    """All in seconds.

    heartbeat: between two heartbeats, and between two looks for dead workers
    lease: a worker that misses heartbeats for so long (three of them) is dead
    first_wait: before the first retry after a fault; it grows up to longest_wait
    wait_for_room: before the first retry of an estimate that was killed or took too long; it
        quadruples with each retry
    drain: for running jobs to end when the worker stops; later ones are handed back
    """

    heartbeat: float = 2.0
    lease: float = 6.0
    first_wait: float = 0.5
    longest_wait: float = 30.0
    wait_for_room: float = 15.0
    drain: float = 5.0


_TURNS = sa.select(  # built once, because every upload runs it
    sa.select(sa.func.max(Job.turn)).where(Job.started_at.is_not(None)).scalar_subquery(),
    sa.select(sa.func.max(Job.turn))
    .where(Job.study_id == sa.bindparam("study_id"))
    .scalar_subquery(),
)


def turns_so_far(session: Session, study_id: uuid.UUID) -> tuple[int, int]:
    """Return the highest turn of a job that was begun, and that of the study's last job; 0 if there is none."""
    reached, last_of_study = session.execute(_TURNS, {"study_id": study_id}).one()
    return reached or 0, last_of_study or 0


# the indexes' condition; finish_job and fail_job set finished_at with the state
_IS_LIVE = Job.finished_at.is_(None)


# the order of the index of waiting jobs
_CLAIM_ORDER = (Job.is_background, Job.turn, Job.enqueued_at, Job.id)


def _is_waiting(protocol: int) -> sa.ColumnElement[bool]:
    now = datetime.now(UTC)
    is_due = sa.or_(
        Job.not_before.is_(None),
        Job.not_before <= now,
        Job.not_before > now + LONGEST_PUT_OFF,
    )
    is_free = sa.and_(_IS_LIVE, Job.executor_id.is_(None), is_due)
    return sa.and_(is_free, Job.protocol <= protocol, Job.takeovers <= MAX_TAKEOVERS)


def waiting_kind(session: Session, protocol: int) -> Literal["ordinary", "background"] | None:
    """Return the kind of job that a worker of this protocol would claim next; None: no job waits."""
    query = (
        sa.select(Job.is_background).where(_is_waiting(protocol)).order_by(*_CLAIM_ORDER).limit(1)
    )
    is_background = session.scalar(query)
    return None if is_background is None else "background" if is_background else "ordinary"


def claim_jobs(
    session: Session,
    executor_id: str,
    *,
    protocol: int,
    room: int,
    is_background: bool = False,
    but: Collection[uuid.UUID] = (),
) -> list[uuid.UUID]:
    """Give waiting jobs of the lowest turns to a worker; skips jobs that another worker is just claiming.

    is_background: claim background jobs instead of ordinary ones
    but: jobs that this worker must not claim
    """
    query = sa.select(Job).where(
        _is_waiting(protocol), Job.is_background == is_background, Job.id.not_in(list(but))
    )
    query = query.order_by(*_CLAIM_ORDER).limit(room)
    claimed = session.scalars(query.with_for_update(skip_locked=True)).all()
    for job in claimed:
        job.executor_id = executor_id
    return [job.id for job in claimed]


def claimed_jobs(session: Session, executor_id: str) -> set[uuid.UUID]:
    """Return the unfinished jobs that this worker has claimed."""
    return set(session.scalars(sa.select(Job.id).where(_IS_LIVE, Job.executor_id == executor_id)))


def executors_with_claims(session: Session) -> set[str]:
    """Return the workers, dead or alive, that have claimed unfinished jobs."""
    query = sa.select(Job.executor_id).where(_IS_LIVE, Job.executor_id.is_not(None)).distinct()
    return {executor_id for executor_id in session.scalars(query) if executor_id is not None}


def release_claims(
    session: Session,
    executor_id: str,
    job_ids: Collection[uuid.UUID] | None = None,
    *,
    is_takeover: bool,
) -> int:
    """Release these jobs of a worker, or all of its jobs, at their old turns. Returns their number.

    Skips a job that is just being saved. is_takeover: the worker did not hand the jobs back itself.
    """
    query = sa.select(Job).where(_IS_LIVE, Job.executor_id == executor_id)
    if job_ids is not None:
        query = query.where(Job.id.in_(job_ids))
    released = session.scalars(query.with_for_update(skip_locked=True)).all()
    for job in released:
        job.executor_id = None
        job.takeovers += is_takeover
    return len(released)


def one_meal(meal_id: uuid.UUID) -> sa.Select[uuid.UUID]:
    """Return a query of the meal's id, empty if the meal does not exist."""
    return sa.select(Meal.id).where(Meal.id == meal_id)


def live_jobs_of(session: Session, meals: sa.Select[uuid.UUID]) -> list[Job]:
    """Return the unfinished jobs of these meals, locked."""
    query = (
        sa.select(Job).where(Job.meal_id.in_(meals), Job.state.in_(LIVE_STATES)).order_by(Job.id)
    )
    return list(session.scalars(query.with_for_update().execution_options(populate_existing=True)))


def lock_live_job(session: Session, job_id: uuid.UUID) -> tuple[Job, Meal] | None:
    """Return an unfinished job and its meal, both locked, the meal first as everywhere; None: finished or erased."""
    meal_id = session.scalar(sa.select(Job.meal_id).where(Job.id == job_id))
    if meal_id is None:
        return None
    meal = session.scalars(
        sa.select(Meal).where(Meal.id == meal_id).with_for_update()
    ).one_or_none()
    job = session.scalars(
        sa.select(Job)
        .where(Job.id == job_id)
        .with_for_update()
        .execution_options(populate_existing=True)
    ).one_or_none()
    if job is None or meal is None:  # erased just now
        return None
    return (job, meal) if job.state in LIVE_STATES else None


def start_attempt(
    session: Session, job_id: uuid.UUID, executor_id: str, now: datetime
) -> Job | None:
    """Record that this worker begins the job; None: it has ended, or another worker has it.

    A job with a computed result is returned unchanged.
    """
    live = lock_live_job(session, job_id)
    if live is None or live[0].executor_id != executor_id:
        return None
    job, meal = live
    if job.result_key is not None:
        return job
    job.state = "processing"
    job.attempts += 1
    job.started_at = job.started_at or now
    if pair_status(meal, job.purpose) == "queued":
        advance_pair(meal, job.purpose, "processing")
    return job


def keep_result(session: Session, job_id: uuid.UUID, executor_id: str, result_key: str) -> None:
    """Keep the key of the computed result, so that a worker which takes the job over need not compute it again."""
    query = sa.update(Job).where(Job.id == job_id, Job.executor_id == executor_id, _IS_LIVE)
    session.execute(query.values(result_key=result_key, faulty_since=None, not_before=None))


def put_off(
    session: Session, job_id: uuid.UUID, executor_id: str, now: datetime, times: WorkerTimes
) -> None:
    """Give a job back, for half of the time that its fault has lasted.

    Without effect if another worker has the job.
    """
    query = sa.select(Job).where(Job.id == job_id, Job.executor_id == executor_id, _IS_LIVE)
    job = session.scalars(query.with_for_update()).one_or_none()
    if job is None:
        return
    job.faulty_since = min(job.faulty_since or now, now)  # the clock may have gone back
    half = (now - job.faulty_since).total_seconds() / 2
    wait = min(max(half, times.first_wait), times.longest_wait)
    job.not_before = now + timedelta(seconds=wait)
    job.state, job.executor_id = "queued", None


def count_faulty(session: Session) -> int:
    """Return how many jobs wait for a fault to pass."""
    return (
        session.scalar(sa.select(sa.func.count()).where(_IS_LIVE, Job.faulty_since.is_not(None)))
        or 0
    )


def unwanted_jobs(session: Session, job_ids: Collection[uuid.UUID]) -> set[uuid.UUID]:
    """Return those of the jobs that need not be done: cancelled, failed, or erased with their meal."""
    return set(job_ids) - set(
        session.scalars(sa.select(Job.id).where(Job.id.in_(job_ids), _IS_LIVE))
    )


def finish_job(job: Job, now: datetime) -> None:
    """End a job whose result is written in the same transaction."""
    job.state, job.finished_at, job.result_key = "done", now, None


def fail_job(job: Job, meal: Meal, failure: Failure, now: datetime) -> None:
    """End a job without a result. Its pair fails, unless the pair's status has changed meanwhile.

    A pair that was measured again keeps its old run, and the remeasurement says why. The caller
    updates the records of a meal whose after-meal pair or redrawn region it was
    (EstimateUseCases.settle).
    """
    job.state, job.finished_at, job.result_key = "failed", now, None
    if job.purpose in RERUN_OF:
        _keep_pair(job, failure.code, now)
    elif pair_status(meal, job.purpose) in WAITING:
        fail_pair(meal, job.purpose, failure)


def drop_job(job: Job, now: datetime) -> None:
    """End a background job without a result and without a failure: what it was for is done by another job."""
    job.state, job.finished_at, job.result_key = "failed", now, None


def _keep_pair(job: Job, reason: str, now: datetime) -> None:
    session = object_session(job)
    if session is not None:
        query = sa.update(RemeasuredPair).where(RemeasuredPair.job_id == job.id)
        session.execute(query.values(state="kept", reason=reason, ended_at=now))


def pair_status(meal: Meal, purpose: str) -> str | None:
    """Return the status of the pair that a job of this purpose estimates; None for other purposes."""
    return meal.pair(purpose).status if purpose in PAIRS else None


def advance_pair(meal: Meal, purpose: str, status: Literal["queued", "processing"]) -> None:
    """Set the pair's status, and raise the meal's version if that changes it."""
    pair = meal.pair(purpose)
    if pair.status != status:
        pair.set_status(status)
        meal.version += 1


def fail_pair(meal: Meal, purpose: str, failure: Failure) -> None:
    """Let the meal's own pair or its after-meal pair fail; the other pair stays unchanged."""
    pair = meal.pair(purpose)
    pair.set_status("failed")
    pair.set_failure(failure)
    meal.version += 1
    session = object_session(meal)
    if purpose == "meal" and session is not None:
        announce_meal(session, meal)


def exhausted_jobs(session: Session) -> list[uuid.UUID]:
    """Return unfinished jobs that no worker claims, because they were taken over too often."""
    query = sa.select(Job.id).where(_IS_LIVE, Job.takeovers > MAX_TAKEOVERS)
    return list(session.scalars(query.order_by(Job.enqueued_at)))


def waiting_without_live_job(session: Session) -> list[tuple[uuid.UUID, PairPurpose]]:
    """Return (meal, purpose) of the pairs that wait for an estimate but have no live job."""
    waiting: list[tuple[uuid.UUID, PairPurpose]] = []
    for purpose in get_args(PairPurpose):
        status = Meal.status if purpose == "meal" else Meal.after_status
        live = sa.exists().where(
            Job.meal_id == Meal.id, Job.purpose == purpose, Job.state.in_(LIVE_STATES)
        )
        query = sa.select(Meal.id).where(status.in_(WAITING), ~live)
        waiting += [
            (meal_id, purpose) for meal_id in session.scalars(query.order_by(Meal.submitted_at))
        ]
    return waiting


def count_jobs(session: Session, meal_id: uuid.UUID, purpose: str) -> tuple[int, int]:
    """Return the numbers of all and of unfinished jobs of a meal for this purpose."""
    states = session.scalars(
        sa.select(Job.state).where(Job.meal_id == meal_id, Job.purpose == purpose)
    ).all()
    return len(states), sum(state in LIVE_STATES for state in states)
