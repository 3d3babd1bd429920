"""The workers' queue: jobs, each one estimate of one meal, and the leases of the workers that run them."""

import uuid
from collections.abc import Mapping
from datetime import datetime
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal, one_of

JOB_STATES = ("queued", "processing", "done", "failed")
LIVE_STATES = ("queued", "processing")
PairPurpose = Literal["meal", "after"]
JobPurpose = Literal[PairPurpose, "remeasure", "rerun", "rerun_after"]
JOB_PURPOSES: tuple[JobPurpose, ...] = get_args(JobPurpose)
RERUN_OF: Mapping[str, PairPurpose] = {
    "rerun": "meal",
    "rerun_after": "after",
}  # by purpose: the pair
_HAS_BEGUN = sa.text("started_at IS NOT NULL")
_IS_WAITING = sa.text("executor_id IS NULL AND finished_at IS NULL")
_IS_CLAIMED = sa.text("executor_id IS NOT NULL AND finished_at IS NULL")
_HAS_STUDY = sa.text("study_id IS NOT NULL")


class Job(Base):
    """One estimate of one meal. Its id becomes the run's id.

    purpose: the meal's pair, its after-meal pair, regions that a person redrew (event_id), or a pair of a remeasurement
    ("rerun", "rerun_after"). turn: studies that share workers take turns (jobs/queue.py); the lowest runs first; 0: not
    assigned yet. study_id: the meal's study. is_background: it runs while nothing else waits, and without a turn.
    protocol: the lowest protocol version of a worker that can run it (jobs/queue.py). executor_id: the worker that
    claimed it, or claimed it last; NULL while it waits. takeovers: how often a worker died with it. result_key: the
    sealed answer, until it is saved. request_id: of the request that queued it. faulty_since: of a fault that lasts;
    the job waits, without a worker, until not_before.
    """

    __tablename__ = "job"
    personal = Personal(("meal_id",))

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    meal_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("meal.id"), index=True)
    purpose: Mapped[JobPurpose] = mapped_column(sa.String(16), default="meal")
    event_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("meal_event.id"), index=True)
    state: Mapped[str] = mapped_column(sa.String(16))
    attempts: Mapped[int] = mapped_column(default=0)
    turn: Mapped[int] = mapped_column(sa.BigInteger, default=0)
    study_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("study.id"))
    is_background: Mapped[bool] = mapped_column(default=False)
    protocol: Mapped[int] = mapped_column(default=1)
    executor_id: Mapped[str | None] = mapped_column(sa.String(64))
    takeovers: Mapped[int] = mapped_column(default=0)
    result_key: Mapped[str | None] = mapped_column(sa.String(300))
    request_id: Mapped[str | None] = mapped_column(sa.String(32))
    enqueued_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    faulty_since: Mapped[datetime | None]
    not_before: Mapped[datetime | None]

    __table_args__ = (
        one_of("state", JOB_STATES),
        one_of("purpose", JOB_PURPOSES),
        sa.CheckConstraint(
            "(state IN ('done', 'failed')) = (finished_at IS NOT NULL)", name="finished"
        ),
        sa.Index(None, "state", "enqueued_at"),
        sa.Index(None, "study_id", "turn", sqlite_where=_HAS_STUDY, postgresql_where=_HAS_STUDY),
        sa.Index(
            "ix_job_turn_of_begun", "turn", sqlite_where=_HAS_BEGUN, postgresql_where=_HAS_BEGUN
        ),
        sa.Index(
            "ix_job_waiting",
            *("is_background", "turn", "enqueued_at", "id"),
            sqlite_where=_IS_WAITING,
            postgresql_where=_IS_WAITING,
        ),
        sa.Index(
            "ix_job_claimed", "executor_id", sqlite_where=_IS_CLAIMED, postgresql_where=_IS_CLAIMED
        ),
    )


class WorkerLease(Base):
    """A worker process's lease, on the database's clock; once it has expired, other workers take over its jobs."""

    __tablename__ = "worker_lease"

    executor_id: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    host: Mapped[str] = mapped_column(sa.String(255))
    pid: Mapped[int]
    version: Mapped[str] = mapped_column(sa.String(32))
    started_at: Mapped[datetime]
    heartbeat_at: Mapped[datetime]
