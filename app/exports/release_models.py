"""Releases: a study's data frozen under a name, as files that stay; only an erasure ever takes rows out of them."""

import uuid
from datetime import datetime
from typing import Any, Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, BlobColumns, one_of
from app.exports.models import FileWork

ReleaseState = Literal["queued", "running", "ready", "changing", "failed"]
RELEASE_STATES: tuple[ReleaseState, ...] = get_args(ReleaseState)
CHANGES = ("meal", "erase", "anonymise")


class Release(FileWork, Base):
    """A study's data of one moment. Its name is never given again: a release is not deleted.

    filters: what was asked for (releases/releases.py). checksum: over the files' SHA-256, by which the release is
    cited. state "changing": something in it was erased, and its files are not served until they are without it; with a
    failure_code: the last try that said why failed by it, and it is tried again.
    altered_at: an erasure took rows out of it then, for the last time; former_checksums: [checksum, until] of before.
    frozen_at: the moment; at_change_seq is as the database counted then (a restored one counts otherwise).
    """

    __tablename__ = "release"

    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"))
    staff_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("staff.id"), index=True)
    name: Mapped[str] = mapped_column(sa.String(64))
    note: Mapped[str] = mapped_column(sa.Text)
    filters: Mapped[dict[str, Any]]
    checksum: Mapped[str | None] = mapped_column(sa.String(64))
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
    """A file of a release. rows: NULL, it is no table."""

    __tablename__ = "release_file"
    blob = BlobColumns()

    release_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("release.id"), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    rows: Mapped[int | None] = mapped_column(sa.BigInteger)
    bytes: Mapped[int] = mapped_column(sa.BigInteger)
    sha256: Mapped[str] = mapped_column(sa.String(64))
    blob_key: Mapped[str] = mapped_column(sa.String(300), unique=True)


class ReleaseChange(Base):
    """What is to be taken out of a release, until it is done: by a digest that only the server's key can make.

    deed: a "meal" goes; a participant goes ("erase"), or stays under new_code ("anonymise"), their meals under ids that
    are drawn by new_ids.
    """

    __tablename__ = "release_change"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    release_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("release.id"), index=True)
    deed: Mapped[str] = mapped_column(sa.String(16))
    digest: Mapped[str] = mapped_column(sa.String(64))
    new_code: Mapped[str | None] = mapped_column(sa.String(64))
    new_ids: Mapped[uuid.UUID | None]
    requested_at: Mapped[datetime]

    __table_args__ = (
        one_of("deed", CHANGES),
        sa.CheckConstraint("(deed = 'anonymise') = (new_code IS NOT NULL)", name="code_of_who_stays"),
    )
