"""The workers' queue: jobs, each one estimate of one meal, and the leases of the workers that run them.

Remeasurements queue jobs too: kept photographs are measured again by today's pipeline, pair by
pair, and the old and new volumes are kept.
"""

import uuid
from collections.abc import Mapping
from datetime import datetime
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal, index_where, one_of
from app.db.columns import (
    BigInt,
    ItemRef,
    JobRef,
    MealEventRef,
    MealRef,
    Str16,
    Str32,
    Str64,
    Str200,
    Str300,
    StudyRef,
    UuidKey,
)

JOB_STATES = ("queued", "processing", "done", "failed")
LIVE_STATES = ("queued", "processing")
PairPurpose = Literal["meal", "after"]
JobPurpose = Literal[PairPurpose, "remeasure", "rerun", "rerun_after"]
JOB_PURPOSES: tuple[JobPurpose, ...] = get_args(JobPurpose)
RERUN_OF: Mapping[str, PairPurpose] = {
    "rerun": "meal",
    "rerun_after": "after",
}  # by purpose: the pair


class Job(Base):
    """One estimate of one meal. Its id becomes the run's id.

    purpose: the meal's pair, its after-meal pair, regions that a person redrew (event_id), or a
        pair of a remeasurement ("rerun", "rerun_after")
    turn: studies that share workers take turns (jobs/queue.py); the lowest runs first; 0: not
        assigned yet
    study_id: the meal's study
    is_background: it runs while nothing else waits, and without a turn
    protocol: the lowest protocol version of a worker that can run it (jobs/queue.py)
    executor_id: the worker that claimed it, or claimed it last; NULL while it waits
    takeovers: how often a worker died with it
    result_key: the sealed answer, until it is saved
    request_id: of the request that queued it
    faulty_since: of a fault that lasts; the job waits, without a worker, until not_before
    """

    __tablename__ = "job"
    personal = Personal(("meal_id",))

    id: Mapped[UuidKey]
    meal_id: Mapped[MealRef] = mapped_column(index=True)
    purpose: Mapped[JobPurpose] = mapped_column(sa.String(16), default="meal")
    event_id: Mapped[MealEventRef | None] = mapped_column(index=True)
    state: Mapped[Str16]
    attempts: Mapped[int] = mapped_column(default=0)
    turn: Mapped[BigInt] = mapped_column(default=0)
    study_id: Mapped[StudyRef | None]
    is_background: Mapped[bool] = mapped_column(default=False)
    protocol: Mapped[int] = mapped_column(default=1)
    executor_id: Mapped[Str64 | None]
    takeovers: Mapped[int] = mapped_column(default=0)
    result_key: Mapped[Str300 | None]
    request_id: Mapped[Str32 | None]
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
        index_where(None, "study_id", "turn", where="study_id IS NOT NULL"),
        index_where("ix_job_turn_of_begun", "turn", where="started_at IS NOT NULL"),
        index_where(
            "ix_job_waiting",
            *("is_background", "turn", "enqueued_at", "id"),
            where="executor_id IS NULL AND finished_at IS NULL",
        ),
        index_where(
            "ix_job_claimed", "executor_id", where="executor_id IS NOT NULL AND finished_at IS NULL"
        ),
    )


class WorkerLease(Base):
    """A worker process's lease, on the database's clock; once it has expired, other workers take over its jobs."""

    __tablename__ = "worker_lease"

    executor_id: Mapped[Str64] = mapped_column(primary_key=True)
    host: Mapped[str] = mapped_column(sa.String(255))
    pid: Mapped[int]
    version: Mapped[Str32]
    started_at: Mapped[datetime]
    heartbeat_at: Mapped[datetime]


RemeasurementState = Literal["running", "stopped", "done"]
REMEASUREMENT_STATES: tuple[RemeasurementState, ...] = get_args(RemeasurementState)
PairState = Literal["pending", "queued", "measured", "kept", "skipped"]
PAIR_STATES: tuple[PairState, ...] = get_args(PairState)
PAIRS: tuple[PairPurpose, ...] = get_args(PairPurpose)


class Remeasurement(Base):
    """One request to measure meals of a study again. A study has at most one that is running.

    selection: digest of what was asked for (remeasurements/start.py), by which the same request is
        recognised
    author: name of the staff member or of the operator
    pipeline_version: of the program that took the request
    """

    __tablename__ = "remeasurement"

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef]
    author: Mapped[Str200]
    selection: Mapped[Str64]
    state: Mapped[RemeasurementState] = mapped_column(sa.String(16), default="running")
    pipeline_version: Mapped[Str32]
    created_at: Mapped[datetime]
    ended_at: Mapped[datetime | None]  # stopped or done; NULL while it is running

    __table_args__ = (
        one_of("state", REMEASUREMENT_STATES),
        sa.CheckConstraint("(state = 'running') = (ended_at IS NULL)", name="ended"),
        sa.Index(None, "study_id", "created_at", "id"),
        index_where(
            "uq_remeasurement_running_of_study", "study_id", unique=True, where="state = 'running'"
        ),
    )


class RemeasuredPair(Base):
    """One pair of photographs of a remeasurement: of a meal, or of what was left of it.

    state: pending, queued (job_id: its job), measured (the meal's records rest on the new run),
        kept (they rest on the old one) or skipped (there is nothing to measure); reason: of the
        last two
    job_id: of the job that made the run
    """

    __tablename__ = "remeasured_pair"
    personal = Personal(("meal_id",), "remeasured_pairs", order_by="ended_at")

    remeasurement_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("remeasurement.id"), primary_key=True
    )
    meal_id: Mapped[MealRef] = mapped_column(primary_key=True, index=True)
    pair: Mapped[PairPurpose] = mapped_column(sa.String(16), primary_key=True)
    position: Mapped[int]  # in the order in which the meals were eaten, from 0
    state: Mapped[PairState] = mapped_column(sa.String(16), default="pending")
    reason: Mapped[Str64 | None]
    job_id: Mapped[JobRef | None] = mapped_column(unique=True)
    ended_at: Mapped[datetime | None]

    __table_args__ = (
        one_of("state", PAIR_STATES),
        one_of("pair", PAIRS),
        sa.CheckConstraint("(reason IS NULL) = (state NOT IN ('kept', 'skipped'))", name="reason"),
        sa.CheckConstraint("(ended_at IS NULL) = (state IN ('pending', 'queued'))", name="ended"),
        sa.Index(None, "remeasurement_id", "position", "pair"),
        index_where(
            "ix_remeasured_pair_open",
            *("remeasurement_id", "state", "position"),
            where="state IN ('pending', 'queued')",
        ),
    )


class RemeasuredItem(Base):
    """An item of a measured pair before and after: the pipeline's volumes, and the grams of the record, served.

    old_*: NULL if the old run did not see it; new_*: NULL if the new one did not. The grams include
    what people said.
    """

    __tablename__ = "remeasured_item"
    personal = Personal(("item_id",), "remeasured_items")

    remeasurement_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("remeasurement.id"), primary_key=True
    )
    item_id: Mapped[ItemRef] = mapped_column(primary_key=True, index=True)
    old_volume_ml: Mapped[float | None]
    old_low_ml: Mapped[float | None]
    old_high_ml: Mapped[float | None]
    new_volume_ml: Mapped[float | None]
    new_low_ml: Mapped[float | None]
    new_high_ml: Mapped[float | None]
    old_mass_g: Mapped[float | None]
    new_mass_g: Mapped[float | None]
    is_changed: Mapped[bool]  # whether any of these figures differs, or a flag of the measurement
