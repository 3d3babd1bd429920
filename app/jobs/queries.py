"""SQL of jobs, which are the workers' queue, and of the workers' leases."""

import uuid
from collections.abc import Collection
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Session, object_session

from app.core.errors import Failure
from app.meals.announce import announce_meal
from app.meals.job_models import LIVE_STATES, Job, PairPurpose, WorkerLease
from app.meals.models import Meal
from app.meals.queries import WAITING

# Times that a job is taken over from dead workers; then it is given up, visibly. Generous: a photograph can end its
# child but not the worker, so a worker's death tells of the machine and not of the job that it happened to have.
MAX_TAKEOVERS = 25


@dataclass(frozen=True, slots=True)
class Executor:
    """A worker process that says it lives, as /readyz shows it."""

    executor_id: str
    host: str
    pid: int
    version: str
    started_at: datetime


_TURNS = sa.select(  # built once: every upload asks
    sa.select(sa.func.max(Job.turn)).where(Job.started_at.is_not(None)).scalar_subquery(),
    sa.select(sa.func.max(Job.turn)).where(Job.study_id == sa.bindparam("study_id")).scalar_subquery(),
)


def turns_so_far(session: Session, study_id: uuid.UUID) -> tuple[int, int]:
    """The turn that workers have come to, the highest of all that were begun; that of the study's last job in the line.

    0: none was begun; the study has none.
    """
    now, of_study = session.execute(_TURNS, {"study_id": study_id}).one()
    return now or 0, of_study or 0


@dataclass(frozen=True, slots=True)
class JobNames:
    """What logs and figures tell of a job. request_id: of the request that queued it, where there was one."""

    meal_id: uuid.UUID
    purpose: str
    request_id: str | None
    enqueued_at: datetime
    attempts: int


def names_of_job(session: Session, job_id: uuid.UUID) -> JobNames | None:
    """None: there is no such job any more."""
    query = sa.select(Job.meal_id, Job.purpose, Job.request_id, Job.enqueued_at, Job.attempts).where(Job.id == job_id)
    names = session.execute(query).one_or_none()
    return JobNames(*names) if names is not None else None


_IS_LIVE = Job.finished_at.is_(None)  # as the indexes have it: finish_job and fail_job set it with the state


def _is_waiting(protocol: int) -> sa.ColumnElement[bool]:
    return sa.and_(_IS_LIVE, Job.executor_id.is_(None), Job.protocol <= protocol, Job.takeovers <= MAX_TAKEOVERS)


def is_any_waiting(session: Session, protocol: int) -> bool:
    """Whether there is a job that a worker of this protocol may claim."""
    return session.scalar(sa.select(Job.id).where(_is_waiting(protocol)).limit(1)) is not None


def claim_jobs(session: Session, executor_id: str, *, protocol: int, room: int) -> list[uuid.UUID]:
    """Give waiting jobs to a worker: those of the lowest turns, past those that another worker is just claiming."""
    query = sa.select(Job).where(_is_waiting(protocol)).order_by(Job.turn, Job.enqueued_at, Job.id).limit(room)
    claimed = session.scalars(query.with_for_update(skip_locked=True)).all()
    for job in claimed:
        job.executor_id = executor_id
    return [job.id for job in claimed]


def claimed_jobs(session: Session, executor_id: str) -> set[uuid.UUID]:
    """Jobs still to be done that this worker has claimed."""
    return set(session.scalars(sa.select(Job.id).where(_IS_LIVE, Job.executor_id == executor_id)))


def executors_with_claims(session: Session) -> set[str]:
    """Workers that have claimed jobs which are not finished, dead or alive."""
    query = sa.select(Job.executor_id).where(_IS_LIVE, Job.executor_id.is_not(None)).distinct()
    return {executor_id for executor_id in session.scalars(query) if executor_id is not None}


def release_claims(
    session: Session, executor_id: str, job_ids: Collection[uuid.UUID] | None = None, *, is_takeover: bool
) -> int:
    """Let these jobs of a worker, or all of its jobs, wait again at their old turns. Returns how many.

    One that is just being saved is passed over. is_takeover: the worker did not hand them back by itself.
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
    """The id of a meal that is there, as a query."""
    return sa.select(Meal.id).where(Meal.id == meal_id)


def live_jobs_of(session: Session, meals: sa.Select[uuid.UUID]) -> list[Job]:
    """Jobs of these meals that are still to be done, locked."""
    query = sa.select(Job).where(Job.meal_id.in_(meals), Job.state.in_(LIVE_STATES)).order_by(Job.id)
    return list(session.scalars(query.with_for_update().execution_options(populate_existing=True)))


def lock_live_job(session: Session, job_id: uuid.UUID) -> tuple[Job, Meal] | None:
    """A job that is still to be done and its meal, both locked, meal first as everywhere; None: finished or gone."""
    meal_id = session.scalar(sa.select(Job.meal_id).where(Job.id == job_id))
    if meal_id is None:
        return None
    meal = session.scalars(sa.select(Meal).where(Meal.id == meal_id).with_for_update()).one_or_none()
    job = session.scalars(
        sa.select(Job).where(Job.id == job_id).with_for_update().execution_options(populate_existing=True)
    ).one_or_none()
    if job is None or meal is None:  # erased just now
        return None
    return (job, meal) if job.state in LIVE_STATES else None


def start_attempt(session: Session, job_id: uuid.UUID, executor_id: str, now: datetime) -> Job | None:
    """Note that this worker begins on the job. None: there is nothing to do any more, or another worker has it.

    A job whose result is there already is not begun again.
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
    """Note what was computed, so that whoever takes the job over need not compute it again."""
    query = sa.update(Job).where(Job.id == job_id, Job.executor_id == executor_id, _IS_LIVE)
    session.execute(query.values(result_key=result_key))


def unwanted_jobs(session: Session, job_ids: Collection[uuid.UUID]) -> set[uuid.UUID]:
    """Those of the jobs that are not to be done any more: cancelled, given up, or erased with their meal."""
    return set(job_ids) - set(session.scalars(sa.select(Job.id).where(Job.id.in_(job_ids), _IS_LIVE)))


def finish_job(job: Job, now: datetime) -> None:
    """The job's result is written in this transaction."""
    job.state, job.finished_at, job.result_key = "done", now, None


def fail_job(job: Job, meal: Meal, failure: Failure, now: datetime) -> None:
    """The job ends without a result. The pair that it was for says so, unless it has got another status meanwhile.

    Records that follow from more than the meal's own pair are brought in line by the caller (EstimateUseCases.settle).
    """
    job.state, job.finished_at, job.result_key = "failed", now, None
    if pair_status(meal, job.purpose) in WAITING:
        fail_pair(meal, job.purpose, failure)


def pair_status(meal: Meal, purpose: str) -> str | None:
    """The status of the pair of photographs that a job of this purpose is for; None: it is for none of its own."""
    return {"meal": meal.status, "after": meal.after_status}.get(purpose)


def advance_pair(meal: Meal, purpose: str, status: Literal["queued", "processing"]) -> None:
    """Let the pair have this status; if it has it, nothing changes."""
    if pair_status(meal, purpose) == status:
        return
    if purpose == "meal":
        meal.status, meal.stage = status, None
    else:
        meal.after_status = status
    meal.version += 1


def fail_pair(meal: Meal, purpose: str, failure: Failure) -> None:
    """The answer of the meal's own pair, or of its after-meal pair, is this failure; the other one's stays."""
    meal.version += 1
    if purpose != "meal":
        meal.after_status, meal.after_failure_code = "failed", failure.code
        meal.after_failure_message, meal.after_failure_advice = failure.message, failure.advice
        return
    meal.status, meal.stage, meal.failure_code = "failed", None, failure.code
    meal.failure_message, meal.failure_advice = failure.message, failure.advice
    session = object_session(meal)
    if session is not None:
        announce_meal(session, meal)


def exhausted_jobs(session: Session) -> list[uuid.UUID]:
    """Jobs to be done that no worker claims any more, since it was taken over too often."""
    query = sa.select(Job.id).where(_IS_LIVE, Job.takeovers > MAX_TAKEOVERS)
    return list(session.scalars(query.order_by(Job.enqueued_at)))


def waiting_without_live_job(session: Session) -> list[tuple[uuid.UUID, PairPurpose]]:
    """Return (meal, purpose) of the pairs that wait for an estimate but have no live job."""
    waiting: list[tuple[uuid.UUID, PairPurpose]] = []
    for purpose in get_args(PairPurpose):
        status = Meal.status if purpose == "meal" else Meal.after_status
        live = sa.exists().where(Job.meal_id == Meal.id, Job.purpose == purpose, Job.state.in_(LIVE_STATES))
        query = sa.select(Meal.id).where(status.in_(WAITING), ~live)
        waiting += [(meal_id, purpose) for meal_id in session.scalars(query.order_by(Meal.submitted_at))]
    return waiting


def count_jobs(session: Session, meal_id: uuid.UUID, purpose: str) -> tuple[int, int]:
    """(all, still to be done) jobs of a meal for this purpose."""
    states = session.scalars(sa.select(Job.state).where(Job.meal_id == meal_id, Job.purpose == purpose)).all()
    return len(states), sum(state in LIVE_STATES for state in states)


def insert_lease(session: Session, executor: Executor) -> None:
    """The first heartbeat of a worker, on the database's clock."""
    session.execute(sa.insert(WorkerLease).values(**asdict(executor), heartbeat_at=_clock()))


def renew_lease(session: Session, executor_id: str) -> bool:
    """A heartbeat, be it late. False: the lease was taken, and cannot be had back."""
    renewed = session.execute(
        sa.update(WorkerLease)
        .where(WorkerLease.executor_id == executor_id)
        .values(heartbeat_at=_clock())
        .returning(WorkerLease.executor_id)
    )
    return renewed.first() is not None


def hold_lease(session: Session, executor_id: str, lease_seconds: float) -> bool:
    """Whether nobody has taken the lease, and keep it from being taken until this transaction ends.

    FOR KEY SHARE: our own heartbeats pass, a takeover passes the row over.
    """
    # a worker that is stopped in the middle of its transaction must not keep the rows locked for those who take over
    session.execute(sa.text(f"SET LOCAL idle_in_transaction_session_timeout = {int(lease_seconds * 1000)}"))
    held = session.scalar(
        sa.select(WorkerLease.executor_id)
        .where(WorkerLease.executor_id == executor_id)
        .with_for_update(read=True, key_share=True)
    )
    return held is not None


def delete_lease(session: Session, executor_id: str) -> None:
    """A worker ends by itself."""
    session.execute(sa.delete(WorkerLease).where(WorkerLease.executor_id == executor_id))


def delete_expired_leases(session: Session, lease_seconds: float) -> list[str]:
    """Take the leases that ran out, but none whose worker is just saving under it."""
    return _delete_leases(session, ~_is_fresh(lease_seconds))


def leases_ahead(session: Session) -> set[tuple[str, datetime]]:
    """(executor, heartbeat) of leases from a time to come: the database's clock went back since."""
    query = sa.select(WorkerLease.executor_id, WorkerLease.heartbeat_at).where(WorkerLease.heartbeat_at > _clock())
    return {(row.executor_id, row.heartbeat_at) for row in session.execute(query)}


def delete_lease_ahead(session: Session, executor_id: str, heartbeat_at: datetime) -> None:
    """Take a lease that still has this heartbeat, unless its worker is just saving under it."""
    _delete_leases(session, WorkerLease.executor_id == executor_id, WorkerLease.heartbeat_at == heartbeat_at)


def leases(session: Session) -> set[str]:
    """Executors that hold a lease, run out or not: nobody has taken it yet."""
    return set(session.scalars(sa.select(WorkerLease.executor_id)))


def fresh_leases(session: Session, lease_seconds: float) -> list[Executor]:
    """Workers whose heartbeat is recent on the database's clock."""
    rows = session.scalars(
        sa.select(WorkerLease).where(_is_alive(lease_seconds)).order_by(WorkerLease.started_at, WorkerLease.executor_id)
    )
    return [Executor(row.executor_id, row.host, row.pid, row.version, row.started_at) for row in rows]


def _delete_leases(session: Session, *conditions: sa.ColumnElement[bool]) -> list[str]:
    chosen = sa.select(WorkerLease.executor_id).where(*conditions).with_for_update(skip_locked=True).subquery()
    return list(
        session.scalars(
            sa.delete(WorkerLease)
            .where(WorkerLease.executor_id.in_(sa.select(chosen.c.executor_id)))
            .returning(WorkerLease.executor_id)
            .execution_options(synchronize_session=False)
        )
    )


def _clock() -> sa.Function[datetime]:
    return sa.func.clock_timestamp(type_=sa.DateTime(timezone=True))


def _is_fresh(lease_seconds: float) -> sa.ColumnElement[bool]:
    return WorkerLease.heartbeat_at > _clock() - timedelta(seconds=lease_seconds)


def _is_alive(lease_seconds: float) -> sa.ColumnElement[bool]:
    """Fresh, and not of a time to come: the database's clock went back, and who lives has renewed it since."""
    return sa.and_(_is_fresh(lease_seconds), WorkerLease.heartbeat_at < _clock() + timedelta(seconds=lease_seconds))
