"""Studies, their participants, the participants' devices, staff, and the tokens that either presents."""

import uuid
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.models.base import Base, one_of

LOCATION_POLICIES = ("drop", "keep")


class Study(Base):
    """A study. `change_seq` is its counter of changes: locked until commit, so no reader misses a late commit."""

    __tablename__ = "study"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    code: Mapped[str] = mapped_column(sa.String(64), unique=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    marker: Mapped[str | None] = mapped_column(sa.String(64))  # the board that its participants were given
    location_policy: Mapped[str] = mapped_column(sa.String(16), default="drop")
    change_seq: Mapped[int] = mapped_column(sa.BigInteger, default=0)
    created_at: Mapped[datetime]

    __table_args__ = (one_of("location_policy", LOCATION_POLICIES),)


class Participant(Base):
    """A person in a study, by pseudonymous code only."""

    __tablename__ = "participant"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"))
    code: Mapped[str] = mapped_column(sa.String(64))
    created_at: Mapped[datetime]

    __table_args__ = (sa.UniqueConstraint("study_id", "code"),)


class Device(Base):
    """A phone of a participant."""

    __tablename__ = "device"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    participant_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("participant.id"), index=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    enrolled_at: Mapped[datetime]


class Staff(Base):
    """A person who runs the server or works with the data."""

    __tablename__ = "staff"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200), unique=True)
    is_admin: Mapped[bool]
    created_at: Mapped[datetime]


class Enrolment(Base):
    """A one-time code that a device exchanges for its token; only the code's SHA-256 is kept."""

    __tablename__ = "enrolment"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    participant_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("participant.id"), index=True)
    code_sha256: Mapped[str] = mapped_column(sa.String(64), unique=True)
    expires_at: Mapped[datetime]
    used_at: Mapped[datetime | None]
    created_at: Mapped[datetime]


class AccessToken(Base):
    """An opaque bearer token of a device or of a staff member; only its SHA-256 is kept."""

    __tablename__ = "access_token"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    token_sha256: Mapped[str] = mapped_column(sa.String(64), unique=True)
    device_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("device.id"), index=True)
    staff_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("staff.id"), index=True)
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]

    __table_args__ = (sa.CheckConstraint("(device_id IS NULL) <> (staff_id IS NULL)", name="one_owner"),)
