"""Amounts of participants' days by another method, which an owner uploads."""

import uuid
from datetime import date

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal


class ReferenceDay(Base):
    """A participant's day by the reference method. amounts: by headline column; unknown ones are missing."""

    __tablename__ = "reference_day"
    personal = Personal(("participant_id",), "reference_days", order_by="local_date")

    participant_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("participant.id"), primary_key=True
    )
    local_date: Mapped[date] = mapped_column(primary_key=True)
    amounts: Mapped[dict[str, float]]
