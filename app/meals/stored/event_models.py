"""People's events about a meal, its items and a day, append-only: who, when, the old value and the new one.

There are three layers: the pipeline's results ("automatic"), the participant's events, and the
reviewer's, which take precedence. The current state is a projection (item_state.py,
diary/diary.py). An event never changes; an `undo` names the event that it undoes. A participant's
day is closed or open: a forgotten meal looks like an open day.
"""

import uuid
from datetime import date, datetime
from typing import Any, Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal, index_where, one_of
from app.db.columns import (
    BigInt,
    DeviceRef,
    MealRef,
    ParticipantRef,
    StaffRef,
    Str16,
    Str64,
    Str200,
    StudyRef,
    UuidKey,
    Version,
)

# in the order of their precedence, the lowest first
Layer = Literal["automatic", "participant", "reviewer"]
LAYERS: tuple[Layer, ...] = get_args(Layer)
EventKind = Literal[
    "confirm", "reject", "set_food", "set_volume", "set_mass", "set_share", "set_leftover", "add", "declare", "split",
    "merge", "redraw", "reshape", "nothing_left", "confirm_meal", "comment", "question", "answer", "undo"
]  # fmt: skip
EVENT_KINDS: tuple[EventKind, ...] = get_args(EventKind)


class MealEvent(Base):
    """One event of a meal; sequence: its number within the meal, from 1.

    item_id: the item that it is about; no foreign key, since items refer to the events that made
        them
    old, new: the values before and after, as in the API; new of an undo names the undone event
    request_sha256: of the request, so that a repetition is recognised
    """

    __tablename__ = "meal_event"
    personal = Personal(("meal_id",), "events", order_by="sequence")

    id: Mapped[UuidKey]
    meal_id: Mapped[MealRef]
    sequence: Mapped[int]
    item_id: Mapped[uuid.UUID | None] = mapped_column(index=True)
    kind: Mapped[EventKind] = mapped_column(sa.String(16))
    layer: Mapped[Layer] = mapped_column(sa.String(16))
    device_id: Mapped[DeviceRef | None] = mapped_column(index=True)
    staff_id: Mapped[StaffRef | None]
    old: Mapped[dict[str, Any]]
    new: Mapped[dict[str, Any]]
    request_sha256: Mapped[Str64]
    created_at: Mapped[datetime]

    __table_args__ = (
        one_of("kind", EVENT_KINDS),
        one_of("layer", LAYERS),
        sa.UniqueConstraint("meal_id", "sequence"),
        index_where("ix_meal_event_questions", "meal_id", where="kind = 'question'"),
    )


DayStatus = Literal["open", "closed"]
DAY_STATUSES: tuple[DayStatus, ...] = get_args(DayStatus)
DayEventKind = Literal["closed", "ate_nothing", "reopened"]
DAY_EVENT_KINDS: tuple[DayEventKind, ...] = get_args(DayEventKind)


class DayEvent(Base):
    """A statement about a local day; append-only, the newest of the highest layer counts.

    closed: everything that was eaten is recorded. ate_nothing: closed, and nothing was eaten.
    reopened: open again.
    """

    __tablename__ = "day_event"
    personal = Personal(("participant_id",), "day_events")

    id: Mapped[UuidKey]
    participant_id: Mapped[ParticipantRef]
    local_date: Mapped[date]
    kind: Mapped[DayEventKind] = mapped_column(sa.String(16))
    layer: Mapped[Str16]
    author: Mapped[Str200]
    created_at: Mapped[datetime]

    __table_args__ = (
        one_of("kind", DAY_EVENT_KINDS),
        one_of("layer", LAYERS),
        sa.Index(None, "participant_id", "local_date"),
    )


class DiaryDay(Base):
    """The state of a local day, a projection of its events. A day without a row is open.

    id: identifies the day in lists of changes; it reveals nothing, and may be listed after the day
    is erased.
    """

    __tablename__ = "diary_day"
    personal = Personal(("participant_id",), "days", order_by="local_date")

    participant_id: Mapped[ParticipantRef] = mapped_column(primary_key=True)
    local_date: Mapped[date] = mapped_column(primary_key=True)
    id: Mapped[uuid.UUID] = mapped_column(unique=True, default=uuid.uuid4)
    study_id: Mapped[StudyRef]
    status: Mapped[DayStatus] = mapped_column(sa.String(16))
    ate_nothing: Mapped[bool]
    version: Mapped[Version]
    changed_at: Mapped[datetime]
    change_seq: Mapped[BigInt]

    __table_args__ = (
        one_of("status", DAY_STATUSES),
        sa.Index(None, "study_id", "local_date"),
        sa.Index(None, "study_id", "change_seq"),
    )
