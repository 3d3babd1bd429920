"""SQL of jobs, of the workers' leases, and what we read of DBOS's table of workflows; its one write: forgive_claim."""

import functools
import uuid
from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timedelta

import sqlalchemy as sa
from sqlalchemy.orm import Session, object_session

from app.db.models import Job, Meal, WorkerLease
from app.db.outbox import announce_meal
from app.db.queries.meals import WAITING
from app.errors import Failure

LIVE_STATES = ("queued", "processing")
MOVING_STATUSES = ("PENDING", "ENQUEUED", "DELAYED")  # DBOS's words for a workflow that has an end before it
ENDED_STATUSES = ("SUCCESS", "ERROR", "CANCELLED", "MAX_RECOVERY_ATTEMPTS_EXCEEDED")  # and for one that has ended
DBOS_SCHEMA = "dbos"  # on PostgreSQL; on SQLite its tables stand beside ours


def _workflow_table(schema: str | None) -> sa.TableClause:
    names = ("workflow_uuid", "status", "executor_id", "application_name")
    texts = (sa.column(name, sa.Text()) for name in names)
    others = (
        sa.column("attributes", sa.JSON()),
        sa.column("completed_at", sa.BigInteger()),
        sa.column("recovery_attempts", sa.BigInteger()),
    )
    return sa.table("workflow_status", *texts, *others, schema=schema)


_WORKFLOW = {"sqlite": _workflow_table(None), "postgresql": _workflow_table(DBOS_SCHEMA)}


@dataclass(frozen=True, slots=True)
class Executor:
    """A worker process that says it lives, as /readyz shows it."""

    executor_id: str
    host: str
    pid: int
    version: str
    started_at: datetime


_TURNS = sa.select(  # built once: every upload asks
    sa.select(sa.func.max(Job.turn)).where(Job.turn > 0, Job.started_at.is_not(None)).scalar_subquery(),
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
    workflow = _WORKFLOW[session.get_bind().dialect.name]
    found = session.execute(
        sa.select(Job.meal_id, Job.purpose, workflow.c.attributes, Job.enqueued_at, Job.attempts)
        .outerjoin(workflow, workflow.c.workflow_uuid == str(job_id))
        .where(Job.id == job_id)
    ).one_or_none()
    if found is None:
        return None
    meal_id, purpose, attributes, enqueued_at, attempts = found
    return JobNames(meal_id, purpose, (attributes or {}).get("request_id"), enqueued_at, attempts)


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


def start_attempt(session: Session, job_id: uuid.UUID, executor_id: str, now: datetime) -> bool:
    """Note that this worker begins on the job. False: there is nothing to do any more."""
    found = lock_live_job(session, job_id)
    if found is None:
        return False
    job, meal = found
    job.state, job.executor_id = "processing", executor_id
    job.attempts += 1
    job.started_at = job.started_at or now
    if job.purpose == "meal" and meal.status == "queued":
        meal.status = "processing"
        meal.version += 1
    elif job.purpose == "after" and meal.after_status == "queued":
        meal.after_status = "processing"
        meal.version += 1
    return True


def unwanted_jobs(session: Session, job_ids: Collection[str]) -> set[str]:
    """Those of the jobs that are not to be done any more: cancelled, given up, or erased with their meal."""
    wanted = sa.select(Job.id).where(Job.id.in_([uuid.UUID(job_id) for job_id in job_ids]), Job.state.in_(LIVE_STATES))
    return set(job_ids) - {str(job_id) for job_id in session.scalars(wanted)}


def finish_job(job: Job, now: datetime) -> None:
    """The job's result is written in this transaction."""
    job.state, job.finished_at = "done", now


def fail_job(job: Job, meal: Meal, failure: Failure, now: datetime) -> None:
    """The job ends without a result. The pair that it was for says so, unless it has got another status meanwhile.

    Records that follow from more than the meal's own pair are brought in line by the caller (EstimateUseCases.settle).
    """
    job.state, job.finished_at = "failed", now
    if job.purpose == "meal" and meal.status in WAITING:
        fail_meal(meal, failure)
    elif job.purpose == "after" and meal.after_status in WAITING:
        fail_after_pair(meal, failure)


def fail_meal(meal: Meal, failure: Failure) -> None:
    """The meal's answer is this failure."""
    meal.status, meal.stage = "failed", None
    meal.failure_code = failure.code
    meal.failure_message = failure.message
    meal.failure_advice = failure.advice
    meal.version += 1
    session = object_session(meal)
    if session is not None:
        announce_meal(session, meal)


def fail_after_pair(meal: Meal, failure: Failure) -> None:
    """The answer of the meal's after-meal pair is this failure; the meal's own stays."""
    meal.after_status = "failed"
    meal.after_failure_code = failure.code
    meal.after_failure_message = failure.message
    meal.after_failure_advice = failure.advice
    meal.version += 1


def stuck_jobs(session: Session) -> list[uuid.UUID]:
    """Jobs to be done that no workflow will do: it is not there, or it has ended."""
    workflow = _WORKFLOW[session.get_bind().dialect.name]
    return list(
        session.scalars(
            sa.select(Job.id)
            .outerjoin(workflow, _is_workflow_of(session, workflow))
            .where(Job.state.in_(LIVE_STATES))
            .where(sa.or_(workflow.c.status.is_(None), workflow.c.status.not_in(MOVING_STATUSES)))
            .order_by(Job.enqueued_at)
        )
    )


def workflow_status(session: Session, job_id: uuid.UUID) -> str | None:
    """DBOS's word on the job's workflow; None: there is no such workflow."""
    workflow = _WORKFLOW[session.get_bind().dialect.name]
    return session.scalar(sa.select(workflow.c.status).where(workflow.c.workflow_uuid == str(job_id)))


def waiting_without_live_job(session: Session) -> list[tuple[uuid.UUID, str]]:
    """(meal, purpose) of the pairs that say they wait while no job will move them."""
    found = []
    for purpose, status in (("meal", Meal.status), ("after", Meal.after_status)):
        live = sa.exists().where(Job.meal_id == Meal.id, Job.purpose == purpose, Job.state.in_(LIVE_STATES))
        query = sa.select(Meal.id).where(status.in_(WAITING), ~live)
        found += [(meal_id, purpose) for meal_id in session.scalars(query.order_by(Meal.submitted_at))]
    return found


def count_jobs(session: Session, meal_id: uuid.UUID, purpose: str) -> tuple[int, int]:
    """(all, still to be done) jobs of a meal for this purpose."""
    states = session.scalars(sa.select(Job.state).where(Job.meal_id == meal_id, Job.purpose == purpose)).all()
    return len(states), sum(state in LIVE_STATES for state in states)


def executors_with_pending_work(session: Session, application: str) -> set[str]:
    """Workers that have claimed workflows which are not finished, dead or alive."""
    workflow = _WORKFLOW[session.get_bind().dialect.name]
    return set(
        session.scalars(
            sa.select(workflow.c.executor_id)
            .where(workflow.c.status == "PENDING", workflow.c.application_name == application)
            .where(workflow.c.executor_id.is_not(None))
            .distinct()
        )
    )


def pending_workflows_of(session: Session, executor_id: str) -> set[str]:
    """Ids of the unfinished workflows that one worker has claimed."""
    workflow = _WORKFLOW[session.get_bind().dialect.name]
    return set(
        session.scalars(
            sa.select(workflow.c.workflow_uuid).where(
                workflow.c.status == "PENDING", workflow.c.executor_id == executor_id
            )
        )
    )


def forgive_claim(session: Session, workflow_id: str, executor_id: str) -> None:
    """Do not count this claim towards the limit of takeovers: its worker hands the job back in good order."""
    workflow = _WORKFLOW[session.get_bind().dialect.name]
    session.execute(
        sa.update(workflow)
        .where(workflow.c.workflow_uuid == workflow_id, workflow.c.executor_id == executor_id)
        .where(workflow.c.status == "PENDING", workflow.c.recovery_attempts > 0)
        .values(recovery_attempts=workflow.c.recovery_attempts - 1)
    )


def ended_workflows(session: Session, application: str, before: datetime, limit: int) -> list[str]:
    """Workflows that ended before that time, locked, those that ended first; none whose job is still to be done."""
    workflow = _WORKFLOW[session.get_bind().dialect.name]
    live = sa.exists().where(_is_workflow_of(session, workflow), Job.state.in_(LIVE_STATES))
    query = (
        sa.select(workflow.c.workflow_uuid)
        .where(workflow.c.completed_at < int(before.timestamp() * 1000), workflow.c.completed_at.is_not(None))
        .where(workflow.c.status.in_(ENDED_STATUSES), workflow.c.application_name == application, ~live)
        .order_by(workflow.c.completed_at)
        .limit(limit)
        .with_for_update(skip_locked=True)  # several workers prune, each its own
    )
    return list(session.scalars(query))


def insert_lease(session: Session, executor: Executor) -> None:
    """The first heartbeat of a worker, on the database's clock."""
    session.execute(
        sa.insert(WorkerLease).values(
            executor_id=executor.executor_id,
            host=executor.host,
            pid=executor.pid,
            version=executor.version,
            started_at=executor.started_at,
            heartbeat_at=_clock(),
        )
    )


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


def _is_workflow_of(session: Session, workflow: sa.TableClause) -> sa.ColumnElement[bool]:
    """workflow_uuid = job.id, so written that the workflows' key is used.

    DBOS writes the UUID with dashes; SQLite keeps ours as 32 hex digits.
    """
    if session.get_bind().dialect.name != "sqlite":
        return workflow.c.workflow_uuid == sa.cast(Job.id, sa.Text())
    digits = sa.type_coerce(Job.id, sa.String())
    groups: list[sa.ColumnElement[str]] = [
        sa.func.substr(digits, start, length) for start, length in ((1, 8), (9, 4), (13, 4), (17, 4), (21, 12))
    ]
    dashed = functools.reduce(lambda left, right: left.concat("-").concat(right), groups)
    return workflow.c.workflow_uuid == dashed


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
