"""Tables of releases: a study's data frozen under a name. Only an erasure ever removes rows from their files."""

import uuid
from datetime import datetime
from typing import Any, Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, BlobColumns, one_of
from app.db.columns import (
    BigInt,
    LongStr,
    ReleaseRef,
    StaffRef,
    Str16,
    Str64,
    Str300,
    StudyRef,
    UuidKey,
)
from app.exports.models import FileWork

ReleaseState = Literal["queued", "running", "ready", "changing", "failed"]
RELEASE_STATES: tuple[ReleaseState, ...] = get_args(ReleaseState)
CHANGES = ("meal", "erase", "anonymise")


class Release(FileWork, Base):
    """A study's data of one moment. It is never deleted, and its name is never used again.

    filters: as requested (releases/releases.py). checksum: over the files' SHA-256, for citations. state "changing":
    something in it was erased, and its files are not served until they are rewritten; failure_code is then the last
    attempt's, which is repeated. altered_at: when an erasure last removed rows; former_checksums: earlier
    [checksum, until]. frozen_at: the moment of the data; at_change_seq: the study's change counter then (a restored
    database counts differently).
    """

    __tablename__ = "release"

    study_id: Mapped[StudyRef]
    staff_id: Mapped[StaffRef] = mapped_column(index=True)
    name: Mapped[Str64]
    note: Mapped[LongStr]
    filters: Mapped[dict[str, Any]]
    checksum: Mapped[Str64 | None]
    frozen_at: Mapped[datetime | None]
    altered_at: Mapped[datetime | None]
    former_checksums: Mapped[list[Any]]

    __table_args__ = (
        one_of("state", RELEASE_STATES),
        sa.UniqueConstraint("study_id", "name"),
        sa.Index(None, "study_id", "requested_at", "id"),
        sa.Index(None, "state", "requested_at"),
    )


class ReleaseFile(Base):
    """A file of a release. rows: NULL if it is no table."""

    __tablename__ = "release_file"
    blob = BlobColumns()

    release_id: Mapped[ReleaseRef] = mapped_column(primary_key=True)
    name: Mapped[Str64] = mapped_column(primary_key=True)
    rows: Mapped[BigInt | None]
    bytes: Mapped[BigInt]
    sha256: Mapped[Str64]
    blob_key: Mapped[Str300] = mapped_column(unique=True)


class ReleaseChange(Base):
    """A pending removal from a release. digest: of the meal or participant, keyed with the server's key.

    deed: "meal" removes a meal; "erase" removes a participant; "anonymise" renames a participant to new_code, with meal
    ids derived from new_ids.
    """

    __tablename__ = "release_change"

    id: Mapped[UuidKey]
    release_id: Mapped[ReleaseRef] = mapped_column(index=True)
    deed: Mapped[Str16]
    digest: Mapped[Str64]
    new_code: Mapped[Str64 | None]
    new_ids: Mapped[uuid.UUID | None]
    requested_at: Mapped[datetime]

    __table_args__ = (
        one_of("deed", CHANGES),
        sa.CheckConstraint(
            "(deed = 'anonymise') = (new_code IS NOT NULL)", name="code_of_who_stays"
        ),
    )
