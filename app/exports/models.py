"""Tables of files that are made in the background by a worker's side process: exports, which are kept for some days."""

import uuid
from datetime import datetime
from typing import Any, Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, BlobColumns, index_where, one_of
from app.db.columns import BigInt, StaffRef, Str16, Str64, Str300, StudyRef, UuidKey

ExportState = Literal["queued", "running", "done", "failed", "cancelled", "expired"]
EXPORT_STATES: tuple[ExportState, ...] = get_args(ExportState)
UNDER_WAY = ("queued", "running")


class FileWork:
    """Columns of the work on a file (exports/file_work_queries.py, releases/file_runner.py).

    claim: random id of the process that works on it, NULL: none. heartbeat_at: the claim's last heartbeat, on the
    database's clock; after a lease without one the work is taken over. attempts: how often it was started.
    begin_after: after a fault, not before then. rows_written, bytes: so far, in the end the total.
    """

    id: Mapped[UuidKey]
    state: Mapped[Str16]
    claim: Mapped[uuid.UUID | None]
    heartbeat_at: Mapped[datetime | None]
    attempts: Mapped[int] = mapped_column(default=0)
    begin_after: Mapped[datetime | None]
    requested_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    rows_written: Mapped[BigInt] = mapped_column(default=0)
    rows_estimated: Mapped[BigInt | None]
    bytes: Mapped[BigInt] = mapped_column(default=0)
    at_change_seq: Mapped[BigInt | None]
    failure_code: Mapped[Str64 | None]


class Export(FileWork, Base):
    """A file of a study's rows, requested by a staff member; available to everybody in the study until it expires.

    spec: the request (exports/background_exports.py); spec_sha256: its digest, so that a repeated request is made once.
    at_change_seq: the study's change counter at the moment of the file's data. blob_key: NULL if there is no file yet,
    or no longer. Not in backups.
    """

    __tablename__ = "export"
    blob = BlobColumns()

    study_id: Mapped[StudyRef]
    staff_id: Mapped[StaffRef] = mapped_column(index=True)
    spec: Mapped[dict[str, Any]]
    spec_sha256: Mapped[Str64]
    sha256: Mapped[Str64 | None]
    blob_key: Mapped[Str300 | None] = mapped_column(unique=True)
    expires_at: Mapped[datetime | None]

    __table_args__ = (
        one_of("state", EXPORT_STATES),
        sa.CheckConstraint(
            "(state = 'done') = (blob_key IS NOT NULL)", name="file_of_what_is_done"
        ),
        sa.Index(None, "study_id", "requested_at", "id"),
        sa.Index(None, "state", "requested_at"),
        index_where(
            "uq_export_under_way",
            *("study_id", "staff_id", "spec_sha256"),
            unique=True,
            where="state IN ('queued', 'running')",
        ),
    )
