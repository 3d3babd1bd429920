"""A participant's days: closed or open, and what they come to. Means leave open days out.

A forgotten meal looks like an open day.
"""

import uuid
from datetime import date

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, one_of
from app.meals.day_models import DAY_STATUSES, DayStatus
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.privacy_models import BigId


class DaySum(Base):
    """What a participant-day comes to: a projection of its meals, records and word, so that a study is summed quickly.

    Beside these columns it has a sum and a coverage of each of HEADLINE_COLUMNS. All is counted in one place
    (diary/day_definition.py) and written down from there. While a DayMark of the day is there the row may be of
    before: whoever reads counts that day itself. Columns as DayRow has them; beside those, late_meals: arrived more
    than a day after they were eaten; located_meals: whose place is kept; unseen_leftovers_items: counted as eaten up
    since nobody has looked, whether or not the study expects it; *_meals by status. Without a diary entry the day is
    open, and said_nothing false.
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
    """A participant-day of which something has changed since its DaySum was written; one for each change.

    Made by triggers (operations/triggers.py) in the transaction of the change, so that no writer can forget it. Nothing
    is updated and nothing waits: two who change meals of one day at the same time each leave a mark. Without
    references, since an erasure must not wait for it.
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
    """What a study's local day comes to over its participants: a projection of DaySum, so that a year is told at once.

    What holds is counted in one place (study_day_sum_queries.py) and written down from there. While a DayMark or a
    StudyDayMark of the day is there the row may be of before, or not there: whoever reads counts that day itself.
    Columns as DayCounts has them; delays: seconds from eating to arrival of each meal; of each of HEADLINE_COLUMNS the
    amounts on the days of which all that was eaten is known: both as SortedValues has them.
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
    """A study's local day of which something has changed since its StudyDaySum was written; one for each change.

    Made where a DaySum is written or removed, and by a trigger where a participant's days begin or end elsewhere
    (operations/triggers.py). As with DayMark nothing is updated and nothing waits.
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
