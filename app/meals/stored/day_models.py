"""A participant's days: closed or open. A forgotten meal looks like an open day."""

import uuid
from datetime import date, datetime
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal, one_of
from app.meals.stored.event_models import LAYERS

DayStatus = Literal["open", "closed"]
DAY_STATUSES: tuple[DayStatus, ...] = get_args(DayStatus)
DayEventKind = Literal["closed", "ate_nothing", "reopened"]
DAY_EVENT_KINDS: tuple[DayEventKind, ...] = get_args(DayEventKind)


class DayEvent(Base):
    """A statement about a local day; append-only, the newest of the highest layer counts.

    closed: everything that was eaten is recorded. ate_nothing: closed, and nothing was eaten. reopened: open again.
    """

    __tablename__ = "day_event"
    personal = Personal(("participant_id",), "day_events")

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    participant_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("participant.id"))
    local_date: Mapped[date]
    kind: Mapped[DayEventKind] = mapped_column(sa.String(16))
    layer: Mapped[str] = mapped_column(sa.String(16))
    author: Mapped[str] = mapped_column(sa.String(200))
    created_at: Mapped[datetime]

    __table_args__ = (
        one_of("kind", DAY_EVENT_KINDS),
        one_of("layer", LAYERS),
        sa.Index(None, "participant_id", "local_date"),
    )


class DiaryDay(Base):
    """The state of a local day, a projection of its events. A day without a row is open.

    id: identifies the day in lists of changes; it reveals nothing, and may be listed after the day is erased.
    """

    __tablename__ = "diary_day"
    personal = Personal(("participant_id",), "days", order_by="local_date")

    participant_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("participant.id"), primary_key=True
    )
    local_date: Mapped[date] = mapped_column(primary_key=True)
    id: Mapped[uuid.UUID] = mapped_column(unique=True, default=uuid.uuid4)
    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"))
    status: Mapped[DayStatus] = mapped_column(sa.String(16))
    ate_nothing: Mapped[bool]
    version: Mapped[int] = mapped_column(default=1)
    changed_at: Mapped[datetime]
    change_seq: Mapped[int] = mapped_column(sa.BigInteger)

    __table_args__ = (
        one_of("status", DAY_STATUSES),
        sa.Index(None, "study_id", "local_date"),
        sa.Index(None, "study_id", "change_seq"),
    )
