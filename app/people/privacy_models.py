"""What keeps promises about data: the audit log, erasures and their receipts, blobs that are to be deleted."""

import uuid
from datetime import datetime
from typing import Any, Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, one_of

ActorKind = Literal["staff", "device", "system"]
ACTOR_KINDS: tuple[ActorKind, ...] = get_args(ActorKind)
TOMBSTONE_KINDS = ("participant", "meal", "token", "record", "day")
BACKUP_MADE = "backup.make"  # the action of an event: a `tada backup` is whole and on disk
ErasedWhat = Literal["participant", "meal", "photographs"]
ErasurePolicy = Literal["keep", "anonymise", "erase", "retention"]
ERASED_WHATS: tuple[ErasedWhat, ...] = get_args(ErasedWhat)

IS_BACKUP = sa.text(f"action = '{BACKUP_MADE}'")  # a parameter in its place would not meet the index's condition

BigId = sa.BigInteger().with_variant(sa.Integer(), "sqlite")  # SQLite counts up INTEGER keys only


class AuditEvent(Base):
    """One read of a photograph or one change: who, when, what. Append-only: the database refuses UPDATE and DELETE.

    People and their meals appear by alias (Participant.alias, Meal.alias) and nothing else: once the row that holds the
    alias is erased, the event leads to nobody. study_id has no foreign key, so that the log outlives all it tells of.
    """

    __tablename__ = "audit_event"

    id: Mapped[int] = mapped_column(BigId, primary_key=True)
    at: Mapped[datetime]
    study_id: Mapped[uuid.UUID | None]
    actor_kind: Mapped[ActorKind] = mapped_column(sa.String(16))
    actor: Mapped[str] = mapped_column(sa.String(200))  # a staff member's name, a participant's alias, or "system"
    action: Mapped[str] = mapped_column(sa.String(64))  # such as "photograph.read", "study.change"
    subject: Mapped[str | None] = mapped_column(sa.String(200))  # alias of whom or what it was done to
    details: Mapped[dict[str, Any]]
    request_id: Mapped[str | None] = mapped_column(sa.String(32))

    __table_args__ = (
        one_of("actor_kind", ACTOR_KINDS),
        sa.Index(None, "study_id", "id"),
        sa.Index("ix_audit_event_last_backup", "id", sqlite_where=IS_BACKUP, postgresql_where=IS_BACKUP),
    )


class Tombstone(Base):
    """Something that was here and is erased for good, by a digest that only its holder can make.

    participant, meal, token: HMAC-SHA-256 of the id under the server's secret key. record, day: SHA-256 of the item's,
    the day's id, with the study's change_seq, so that those who pulled it learn that it is gone.
    """

    __tablename__ = "tombstone"

    kind: Mapped[str] = mapped_column(sa.String(16), primary_key=True)
    digest: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    study_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("study.id"))
    change_seq: Mapped[int | None] = mapped_column(sa.BigInteger)
    erased_at: Mapped[datetime]

    __table_args__ = (one_of("kind", TOMBSTONE_KINDS), sa.Index(None, "study_id", "change_seq"))


class SpentCode(Base):
    """A code of a participant who was erased or anonymised: the study gives it to nobody else.

    digest: HMAC-SHA-256 of the code under the server's secret key. Never removed.
    """

    __tablename__ = "spent_code"

    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"), primary_key=True)
    digest: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    spent_at: Mapped[datetime]


class ErasureReceipt(Base):
    """What an erasure removed, in numbers; it names nobody."""

    __tablename__ = "erasure_receipt"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"), index=True)
    what: Mapped[ErasedWhat] = mapped_column(sa.String(16))
    policy: Mapped[ErasurePolicy] = mapped_column(sa.String(16))
    counts: Mapped[dict[str, Any]]
    erased_at: Mapped[datetime]

    __table_args__ = (one_of("what", ERASED_WHATS),)


class BlobDeletion(Base):
    """A blob that is to be deleted, committed with the erasure that wants it; the row goes when the blob is gone."""

    __tablename__ = "blob_deletion"

    blob_key: Mapped[str] = mapped_column(sa.String(300), primary_key=True)
    receipt_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("erasure_receipt.id"))
    requested_at: Mapped[datetime]
