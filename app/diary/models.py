"""Stored sums of days, of participants and of studies, and the marks of days whose sums are outdated."""

import uuid
from datetime import date

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, one_of
from app.meals.day_models import DAY_STATUSES, DayStatus
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.privacy_models import BigId


class DaySum(Base):
    """A participant-day's sums: a projection of its meals, records and diary entry, so that a study is summed quickly.

    Beside these columns the table has a sum and a coverage of each of HEADLINE_COLUMNS. diary/day_definition.py defines
    and counts all of them. While the day has a DayMark, the row may be outdated and readers count the day themselves.
    Columns are those of DayRow, and: late_meals, which arrived more than a day after they were eaten; located_meals,
    whose place is kept; unseen_leftovers_items, counted as eaten up because no leftovers were recorded, whether or not
    the study expects an after-meal pair; *_meals by status. Without a diary entry the day is open and said_nothing
    false.
    """

    __tablename__ = "day_sum"

    participant_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("participant.id", ondelete="CASCADE"), primary_key=True
    )
    local_date: Mapped[date] = mapped_column(primary_key=True)
    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"))
    status: Mapped[DayStatus] = mapped_column(sa.String(16))
    said_nothing: Mapped[bool]
    meals: Mapped[int]
    receiving_meals: Mapped[int]
    queued_meals: Mapped[int]
    processing_meals: Mapped[int]
    estimated_meals: Mapped[int]
    needs_review_meals: Mapped[int]
    failed_meals: Mapped[int]
    confirmed_meals: Mapped[int]
    meals_after_closing: Mapped[int]
    unmeasured_meals: Mapped[int]
    late_meals: Mapped[int]
    located_meals: Mapped[int]
    median_upload_delay_seconds: Mapped[float | None]
    items: Mapped[int]
    unmeasured_items: Mapped[int]
    provisional_items: Mapped[int]
    unseen_leftovers_items: Mapped[int]
    consumed_g: Mapped[float | None]

    __table_args__ = (one_of("status", DAY_STATUSES), sa.Index(None, "study_id", "local_date", "participant_id"))


class DayMark(Base):
    """Marks a participant-day that has changed since its DaySum was written; one row per change.

    Triggers (operations/triggers.py) insert it in the transaction of the change, so that no writer can forget it. Rows
    are never updated, so two transactions that change meals of one day do not wait for each other. It has no foreign
    keys, since an erasure must not wait for it.
    """

    __tablename__ = "day_mark"

    id: Mapped[int] = mapped_column(BigId, primary_key=True, autoincrement=True)
    participant_id: Mapped[uuid.UUID]
    local_date: Mapped[date]
    study_id: Mapped[uuid.UUID]

    __table_args__ = (
        sa.Index(None, "participant_id", "local_date"),
        sa.Index(None, "study_id", "local_date", "participant_id"),
    )


class StudyDaySum(Base):
    """A study's local day, summed over its participants: a projection of DaySum, so that a year is read quickly.

    study_day_sum_queries.py counts and writes it. While the day has a DayMark or a StudyDayMark, the row may be
    outdated or missing and readers count the day themselves. Columns are those of DayCounts, and SortedValues of delays
    (seconds from eating to arrival, per meal) and of each of HEADLINE_COLUMNS (amounts on whole days).
    """

    __tablename__ = "study_day_sum"

    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"), primary_key=True)
    local_date: Mapped[date] = mapped_column(primary_key=True)
    told: Mapped[int]
    told_closed: Mapped[int]
    with_meal: Mapped[int]
    closed: Mapped[int]
    ate_nothing: Mapped[int]
    open_days: Mapped[int]
    open_energy_kcal: Mapped[float | None]
    meals: Mapped[int]
    receiving_meals: Mapped[int]
    queued_meals: Mapped[int]
    processing_meals: Mapped[int]
    estimated_meals: Mapped[int]
    needs_review_meals: Mapped[int]
    failed_meals: Mapped[int]
    confirmed_meals: Mapped[int]
    late_meals: Mapped[int]
    located_meals: Mapped[int]
    unmeasured_meals: Mapped[int]
    items: Mapped[int]
    unmeasured_items: Mapped[int]
    provisional_items: Mapped[int]
    delays: Mapped[bytes]


class StudyDayMark(Base):
    """Marks a study's local day that has changed since its StudyDaySum was written; one row per change.

    Inserted where a DaySum is written or removed, and by a trigger when a participant's first or last expected day
    changes (operations/triggers.py). As with DayMark, rows are never updated.
    """

    __tablename__ = "study_day_mark"

    id: Mapped[int] = mapped_column(BigId, primary_key=True, autoincrement=True)
    study_id: Mapped[uuid.UUID]
    local_date: Mapped[date]

    __table_args__ = (sa.Index(None, "study_id", "local_date"),)


for _name in HEADLINE_COLUMNS:
    setattr(DaySum, _name, mapped_column(sa.Double))
    setattr(DaySum, f"{_name}_coverage", mapped_column(sa.Double))
    setattr(StudyDaySum, _name, mapped_column(sa.LargeBinary, nullable=False))
