"""Remeasurements: kept photographs measured again by today's pipeline, pair by pair, with the old and new volumes."""

import uuid
from datetime import datetime
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal, one_of
from app.meals.stored.job_models import PairPurpose

RemeasurementState = Literal["running", "stopped", "done"]
REMEASUREMENT_STATES: tuple[RemeasurementState, ...] = get_args(RemeasurementState)
PairState = Literal["pending", "queued", "measured", "kept", "skipped"]
PAIR_STATES: tuple[PairState, ...] = get_args(PairState)
PAIRS: tuple[PairPurpose, ...] = get_args(PairPurpose)
_IS_RUNNING = sa.text("state = 'running'")
_IS_OPEN = sa.text("state IN ('pending', 'queued')")


class Remeasurement(Base):
    """One request to measure meals of a study again. A study has at most one that is running.

    selection: digest of what was asked for (remeasurements/start.py), by which the same request is recognised. author:
    name of the staff member or of the operator. pipeline_version: of the program that took the request.
    """

    __tablename__ = "remeasurement"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"))
    author: Mapped[str] = mapped_column(sa.String(200))
    selection: Mapped[str] = mapped_column(sa.String(64))
    state: Mapped[RemeasurementState] = mapped_column(sa.String(16), default="running")
    pipeline_version: Mapped[str] = mapped_column(sa.String(32))
    created_at: Mapped[datetime]
    ended_at: Mapped[datetime | None]  # stopped or done; NULL while it is running

    __table_args__ = (
        one_of("state", REMEASUREMENT_STATES),
        sa.CheckConstraint("(state = 'running') = (ended_at IS NULL)", name="ended"),
        sa.Index(None, "study_id", "created_at", "id"),
        sa.Index(
            "uq_remeasurement_running_of_study",
            "study_id",
            unique=True,
            sqlite_where=_IS_RUNNING,
            postgresql_where=_IS_RUNNING,
        ),
    )


class RemeasuredPair(Base):
    """One pair of photographs of a remeasurement: of a meal, or of what was left of it.

    state: pending, queued (job_id: its job), measured (the meal's records rest on the new run), kept (they rest on the
    old one) or skipped (there is nothing to measure); reason: of the last two. job_id: of the job that made the run.
    """

    __tablename__ = "remeasured_pair"
    personal = Personal(("meal_id",), "remeasured_pairs", order_by="ended_at")

    remeasurement_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("remeasurement.id"), primary_key=True
    )
    meal_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("meal.id"), primary_key=True, index=True
    )
    pair: Mapped[PairPurpose] = mapped_column(sa.String(16), primary_key=True)
    position: Mapped[int]  # in the order in which the meals were eaten, from 0
    state: Mapped[PairState] = mapped_column(sa.String(16), default="pending")
    reason: Mapped[str | None] = mapped_column(sa.String(64))
    job_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("job.id"), unique=True)
    ended_at: Mapped[datetime | None]

    __table_args__ = (
        one_of("state", PAIR_STATES),
        one_of("pair", PAIRS),
        sa.CheckConstraint("(reason IS NULL) = (state NOT IN ('kept', 'skipped'))", name="reason"),
        sa.CheckConstraint("(ended_at IS NULL) = (state IN ('pending', 'queued'))", name="ended"),
        sa.Index(None, "remeasurement_id", "position", "pair"),
        sa.Index(
            "ix_remeasured_pair_open",
            *("remeasurement_id", "state", "position"),
            sqlite_where=_IS_OPEN,
            postgresql_where=_IS_OPEN,
        ),
    )


class RemeasuredItem(Base):
    """An item of a measured pair before and after: the pipeline's volumes, and the grams of the record, served.

    old_*: NULL if the old run did not see it; new_*: NULL if the new one did not. The grams include what people said.
    """

    __tablename__ = "remeasured_item"
    personal = Personal(("item_id",), "remeasured_items")

    remeasurement_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("remeasurement.id"), primary_key=True
    )
    item_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("item.id"), primary_key=True, index=True
    )
    old_volume_ml: Mapped[float | None]
    old_low_ml: Mapped[float | None]
    old_high_ml: Mapped[float | None]
    new_volume_ml: Mapped[float | None]
    new_low_ml: Mapped[float | None]
    new_high_ml: Mapped[float | None]
    old_mass_g: Mapped[float | None]
    new_mass_g: Mapped[float | None]
    is_changed: Mapped[bool]  # whether any of these figures differs, or a flag of the measurement
