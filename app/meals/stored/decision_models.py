"""Decisions of two reviewers about an item without seeing each other, and items with a known answer.

A decision is no event of the meal: nothing that reads a meal reads it. Once an item is settled, the
result is written as events of the meal (records/review/double_review.py).
"""

import uuid
from datetime import datetime
from typing import ClassVar

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, JsonValue, Personal, index_where
from app.db.columns import MealRef, StaffRef, Str100, StudyRef, UuidKey


class ReviewDecision(Base):
    """A reviewer's decision about an item. Only undone_at and settled_at are ever set later.

    meal_id: NULL for an item with a known answer
    item_id: of the meal, or the known item's; no foreign key, as of a meal's events
    is_final: by a third reviewer, who saw the two that differ
    food_key, mass_g, energy_kcal: as served, with peel, core and bone; all NULL: it is no food
    settled_at: when the item got its result, which all its decisions name
    """

    __tablename__ = "review_decision"
    personal = Personal(("meal_id",), "decisions", order_by="decided_at")

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef]
    meal_id: Mapped[MealRef | None] = mapped_column(index=True)
    item_id: Mapped[uuid.UUID]
    staff_id: Mapped[StaffRef]
    is_final: Mapped[bool]
    food_key: Mapped[Str100 | None]
    mass_g: Mapped[float | None]
    energy_kcal: Mapped[float | None]
    decided_at: Mapped[datetime]
    undone_at: Mapped[datetime | None]
    settled_at: Mapped[datetime | None]

    __table_args__ = (
        index_where(
            "ix_review_decision_item_id_staff_id",
            "item_id",
            "staff_id",
            unique=True,
            where="undone_at IS NULL",
        ),
        sa.Index(None, "study_id", "staff_id"),
    )


class KnownItem(Base):
    """An item of no participant, whose food and grams are known, to test reviewers.

    mass_g: true, as served; shown_g: what reviewers see as measured
    rings: its outline, px of the picture; picture: JPEG, made as photographs are made for eyes
    """

    __tablename__ = "known_item"
    energy_kcal: ClassVar[float | None] = None  # as of a decision

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef] = mapped_column(index=True)
    food_key: Mapped[Str100]
    mass_g: Mapped[float]
    shown_g: Mapped[float]
    rings: Mapped[list[list[list[float]]]] = mapped_column(JsonValue)
    picture: Mapped[bytes] = mapped_column(sa.LargeBinary)
    width_px: Mapped[int]
    height_px: Mapped[int]
    created_at: Mapped[datetime]
