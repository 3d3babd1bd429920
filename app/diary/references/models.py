"""Amounts of participants' days by another method, which an owner uploads."""

from datetime import date

from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal
from app.db.columns import ParticipantRef


class ReferenceDay(Base):
    """A participant's day by the reference method. amounts: by headline column; unknown ones are missing."""

    __tablename__ = "reference_day"
    personal = Personal(("participant_id",), "reference_days", order_by="local_date")

    participant_id: Mapped[ParticipantRef] = mapped_column(primary_key=True)
    local_date: Mapped[date] = mapped_column(primary_key=True)
    amounts: Mapped[dict[str, float]]
