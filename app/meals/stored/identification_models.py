"""Identification of items: feature vectors, the index's results, and what a study's index learns.

It learns confirmed items, and photographs that an owner of the study added.
"""

import uuid
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, Personal
from app.db.columns import ParticipantRef, RunRef, Str16, Str64, Str100, StudyRef, UuidKey

# during a rolling upgrade, a process that does not know these tables may erase meals
OF_ITS_ITEM = "CASCADE"


class ItemIdentification(Base):
    """An item's region as one run saw it: its Visual Characterization Metrics, and by which index it was identified.

    Append-only. vector: little-endian float16, of the length of that vcm_version. index_version:
    names what the candidates of this run follow from; NULL with none_probability (that it is none
    of the candidates): described only, as by `tada index rebuild`.
    """

    __tablename__ = "item_identification"
    personal = Personal(("item_id",), "looks")

    item_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("item.id", ondelete=OF_ITS_ITEM), primary_key=True
    )
    run_id: Mapped[RunRef] = mapped_column(primary_key=True, index=True)
    vcm_version: Mapped[Str16] = mapped_column(primary_key=True)
    vector: Mapped[bytes] = mapped_column(sa.LargeBinary)
    index_version: Mapped[Str100 | None]
    none_probability: Mapped[float | None]
    created_at: Mapped[datetime]

    __table_args__ = (
        sa.CheckConstraint(
            "(index_version IS NULL) = (none_probability IS NULL)", name="identified_by_an_index"
        ),
    )


class IndexEntry(Base):
    """A confirmed item in its study's index: what it looks like is in item_identification, under the same run.

    A projection, written with the item's effective record and built again with it: there while the
    record is confirmed or corrected and a person has named the food. food_key: stays from version
    to version of the food. day_minute: of the meal, minutes after local midnight.
    """

    __tablename__ = "index_entry"
    personal = Personal(("item_id",), "known_to_the_index")

    item_id: Mapped[uuid.UUID] = mapped_column(
        sa.ForeignKey("item.id", ondelete=OF_ITS_ITEM), primary_key=True
    )
    run_id: Mapped[RunRef] = mapped_column(index=True)
    vcm_version: Mapped[Str16]
    study_id: Mapped[StudyRef]
    participant_id: Mapped[ParticipantRef] = mapped_column(index=True)
    food_key: Mapped[Str100]
    volume_ml: Mapped[float | None]
    captured_at: Mapped[datetime]
    day_minute: Mapped[int]

    __table_args__ = (
        sa.Index(None, "study_id", "food_key", "captured_at"),
        sa.CheckConstraint("day_minute >= 0 AND day_minute < 1440", name="day_minute"),
    )


class TaughtPhotograph(Base):
    """A photograph that a food fills, by which an owner taught the food; the picture is not kept.

    vector: of its views, one after the other, each as in item_identification
    sha256: of the file, which teaches a food once
    in_force_at: NULL: a draft, by which nothing is identified yet
    """

    __tablename__ = "taught_photograph"

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef]
    food_key: Mapped[Str100]
    sha256: Mapped[Str64]
    vcm_version: Mapped[Str16]
    vector: Mapped[bytes] = mapped_column(sa.LargeBinary)
    created_at: Mapped[datetime]
    in_force_at: Mapped[datetime | None]

    __table_args__ = (sa.Index(None, "study_id", "food_key", "sha256", unique=True),)
