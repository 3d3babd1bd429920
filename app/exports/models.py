"""Files that the server makes in the background, by a worker's side process: exports, which are kept for some days."""

import uuid
from datetime import datetime
from typing import Any, Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, BlobColumns, one_of

ExportState = Literal["queued", "running", "done", "failed", "cancelled", "expired"]
EXPORT_STATES: tuple[ExportState, ...] = get_args(ExportState)
UNDER_WAY = ("queued", "running")
_IS_UNDER_WAY = sa.text("state IN ('queued', 'running')")


class FileWork:
    """What any file in the making has of its making (exports/file_work_queries.py, releases/file_runner.py).

    claim: drawn by who works on it now, NULL: nobody does. heartbeat_at: the claim's last sign of life, on the
    database's clock; without one for a while another takes the work over. attempts: how often it was begun.
    begin_after: not before then, after a fault. rows_written, bytes: so far, or in the end.
    """

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    state: Mapped[str] = mapped_column(sa.String(16))
    claim: Mapped[uuid.UUID | None]
    heartbeat_at: Mapped[datetime | None]
    attempts: Mapped[int] = mapped_column(default=0)
    begin_after: Mapped[datetime | None]
    requested_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    rows_written: Mapped[int] = mapped_column(sa.BigInteger, default=0)
    rows_estimated: Mapped[int | None] = mapped_column(sa.BigInteger)
    bytes: Mapped[int] = mapped_column(sa.BigInteger, default=0)
    at_change_seq: Mapped[int | None] = mapped_column(sa.BigInteger)
    failure_code: Mapped[str | None] = mapped_column(sa.String(64))


class Export(FileWork, Base):
    """A file of a study's rows, asked for by a person of its staff; for whoever may see the study, until it expires.

    spec: what was asked for (exports/background_exports.py); spec_sha256: of it, so that the same asked for twice is
    made once. at_change_seq: the study's counter of changes at the moment that the file is of. blob_key: NULL where
    there is no file (yet, or any more). Not in backups.
    """

    __tablename__ = "export"
    blob = BlobColumns()

    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"))
    staff_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("staff.id"), index=True)
    spec: Mapped[dict[str, Any]]
    spec_sha256: Mapped[str] = mapped_column(sa.String(64))
    sha256: Mapped[str | None] = mapped_column(sa.String(64))
    blob_key: Mapped[str | None] = mapped_column(sa.String(300), unique=True)
    expires_at: Mapped[datetime | None]

    __table_args__ = (
        one_of("state", EXPORT_STATES),
        sa.CheckConstraint("(state = 'done') = (blob_key IS NOT NULL)", name="file_of_what_is_done"),
        sa.Index(None, "study_id", "requested_at", "id"),
        sa.Index(None, "state", "requested_at"),
        sa.Index(
            "uq_export_under_way",
            *("study_id", "staff_id", "spec_sha256"),
            unique=True,
            sqlite_where=_IS_UNDER_WAY,
            postgresql_where=_IS_UNDER_WAY,
        ),
    )
