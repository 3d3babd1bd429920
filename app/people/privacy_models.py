"""The audit log, tombstones, spent codes, receipts of erasures, and blobs that are to be deleted."""

import uuid
from datetime import datetime
from typing import Literal, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, index_where, one_of
from app.db.columns import BigInt, IntKey, Str16, Str32, Str64, Str200, Str300, StudyRef, UuidKey

ActorKind = Literal["staff", "device", "system"]
ACTOR_KINDS: tuple[ActorKind, ...] = get_args(ActorKind)
TOMBSTONE_KINDS = ("participant", "meal", "token", "record", "day")
DEPLOYMENT = 1  # id of the one row
BACKUP_MADE = "backup.make"  # audit action: a `tada backup` is complete and on disk
ErasedKind = Literal["participant", "meal", "photographs"]
ErasurePolicy = Literal["keep", "anonymise", "erase", "retention"]
ERASED_KINDS: tuple[ErasedKind, ...] = get_args(ErasedKind)

# with a bound parameter, queries would not match the index
IS_BACKUP = sa.text(f"action = '{BACKUP_MADE}'")

BigId = sa.BigInteger().with_variant(sa.Integer(), "sqlite")  # SQLite counts up INTEGER keys only


class AuditEvent(Base):
    """A read of a photograph or a change. Append-only: the database refuses UPDATE and DELETE.

    People and their meals appear only by alias (Participant.alias, Meal.alias): once the row with
    the alias is erased, the event is anonymous. study_id has no foreign key, so that events outlive
    what they refer to.
    """

    __tablename__ = "audit_event"

    id: Mapped[int] = mapped_column(BigId, primary_key=True)
    at: Mapped[datetime]
    study_id: Mapped[uuid.UUID | None]
    actor_kind: Mapped[ActorKind] = mapped_column(sa.String(16))
    # a staff member's name, a participant's alias, or "system"
    actor: Mapped[Str200]
    action: Mapped[Str64]  # such as "photograph.read", "study.change"
    # alias or id of the person or object concerned
    subject: Mapped[Str200 | None]
    details: Mapped[dict[str, object]]
    request_id: Mapped[Str32 | None]

    __table_args__ = (
        one_of("actor_kind", ACTOR_KINDS),
        sa.Index(None, "study_id", "id"),
        index_where("ix_audit_event_last_backup", "id", where=IS_BACKUP.text),
    )


class Tombstone(Base):
    """The digest of something that was erased, which identifies it only to those who know its id.

    participant, meal, token: HMAC-SHA-256 of the id under the server's secret key. record, day:
    SHA-256 of the item's or day's id, with the study's change_seq, so that clients that pulled it
    learn of its deletion.
    """

    __tablename__ = "tombstone"

    kind: Mapped[Str16] = mapped_column(primary_key=True)
    digest: Mapped[Str64] = mapped_column(primary_key=True)
    study_id: Mapped[StudyRef | None]
    change_seq: Mapped[BigInt | None]
    erased_at: Mapped[datetime]

    __table_args__ = (one_of("kind", TOMBSTONE_KINDS), sa.Index(None, "study_id", "change_seq"))


class SpentCode(Base):
    """A code of a participant who was erased or anonymised, which the study cannot use again.

    digest: HMAC-SHA-256 of the code under the server's secret key. Never removed.
    """

    __tablename__ = "spent_code"

    study_id: Mapped[StudyRef] = mapped_column(primary_key=True)
    digest: Mapped[Str64] = mapped_column(primary_key=True)
    spent_at: Mapped[datetime]


class ErasureReceipt(Base):
    """The numbers of rows that an erasure removed, without personal data."""

    __tablename__ = "erasure_receipt"

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef] = mapped_column(index=True)
    what: Mapped[ErasedKind] = mapped_column(sa.String(16))
    policy: Mapped[ErasurePolicy] = mapped_column(sa.String(16))
    counts: Mapped[dict[str, int]]
    erased_at: Mapped[datetime]

    __table_args__ = (one_of("what", ERASED_KINDS),)


class Deployment(Base):
    """The one row about the deployment: by it a wrong secret key and a wrong clock are found before they do harm.

    key_check: a digest by the secret key, to compare keys by. clock_at: the clock as a worker last
    saw it. clock_doubted_seconds: for which the workers must still run until the clock is trusted.
    """

    __tablename__ = "deployment"

    id: Mapped[IntKey]  # DEPLOYMENT
    key_check: Mapped[Str64 | None]
    clock_at: Mapped[datetime | None]
    clock_doubted_seconds: Mapped[float]


class BlobDeletion(Base):
    """A blob to delete, committed with its erasure; the row is removed once the blob is deleted.

    A key that ends with a slash means all blobs below it.
    """

    __tablename__ = "blob_deletion"

    blob_key: Mapped[Str300] = mapped_column(primary_key=True)
    receipt_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("erasure_receipt.id"))
    requested_at: Mapped[datetime]
