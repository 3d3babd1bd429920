"""SQL of privacy: locking participants, ending their access, tombstones, blobs to delete, the audit log."""

import uuid
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.people.models import AccessToken, Device, Enrolment, Participant, PushSubscription, Study
from app.people.privacy_models import (
    DEPLOYMENT,
    ActorKind,
    AuditEvent,
    BlobDeletion,
    Deployment,
    ErasureReceipt,
    Tombstone,
)

IN_A_STATEMENT = 500  # values in one IN (...); SQLite takes 32,766


@dataclass(frozen=True, slots=True)
class AuditFilter:
    """Selects events; None: no condition. since: inclusive; until: exclusive."""

    study_id: uuid.UUID | None = None
    action: str | None = None
    since: datetime | None = None
    until: datetime | None = None


@dataclass(frozen=True, slots=True)
class AuditRow:
    """An event of the audit log.

    study: its study's code; None if it belongs to no existing study.
    """

    id: int
    at: datetime
    study: str | None
    actor_kind: ActorKind
    actor: str
    action: str
    subject: str | None
    details: dict[str, object]
    request_id: str | None


def lock_participant(session: Session, participant_id: uuid.UUID) -> Participant | None:
    """Lock a participant exclusively, which also blocks new meals and devices."""
    query = sa.select(Participant).where(Participant.id == participant_id).with_for_update()
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def join_participant(session: Session, participant_id: uuid.UUID | None) -> Participant | None:
    """Lock a participant against withdrawal, to add rows that refer to them; waits for a running withdrawal."""
    query = (
        sa.select(Participant)
        .where(Participant.id == participant_id)
        .with_for_update(read=True, key_share=True)
    )
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def enrolments_of(session: Session, participant_id: uuid.UUID) -> list[Enrolment]:
    """Return a participant's enrolment codes, used or not."""
    return list(
        session.scalars(sa.select(Enrolment).where(Enrolment.participant_id == participant_id))
    )


def end_enrolments(session: Session, participant_id: uuid.UUID) -> None:
    """Delete a participant's enrolment codes, used or not, so that no further phone can enrol."""
    session.execute(sa.delete(Enrolment).where(Enrolment.participant_id == participant_id))


def end_tokens(session: Session, participant_id: uuid.UUID) -> list[str]:
    """Delete the tokens of a participant's devices, and their reminders.

    Returns the tokens' SHA-256.
    """
    devices = sa.select(Device.id).where(Device.participant_id == participant_id)
    session.execute(sa.delete(PushSubscription).where(PushSubscription.device_id.in_(devices)))
    return list(
        session.scalars(
            sa.delete(AccessToken)
            .where(AccessToken.device_id.in_(devices))
            .returning(AccessToken.token_sha256)
        )
    )


def devices_of(session: Session, participant_id: uuid.UUID) -> list[Device]:
    """Return a participant's phones in the order of enrolment."""
    query = (
        sa.select(Device)
        .where(Device.participant_id == participant_id)
        .order_by(Device.enrolled_at, Device.id)
    )
    return list(session.scalars(query))


def count_erased_participants(session: Session, study_id: uuid.UUID) -> int:
    """Count the erased participants of a study; each has one receipt."""
    query = sa.select(sa.func.count()).where(
        ErasureReceipt.study_id == study_id,
        ErasureReceipt.what == "participant",
        ErasureReceipt.policy == "erase",
    )
    return session.scalars(query).one()


def add_tombstones(
    session: Session,
    kind: str,
    digests: Collection[str],
    now: datetime,
    *,
    study_id: uuid.UUID | None,
    change_seq: int | None = None,
) -> None:
    """Add tombstones; existing ones stay unchanged."""
    existing = tombstones_among(session, kind, digests)
    session.add_all(
        Tombstone(kind=kind, digest=digest, study_id=study_id, change_seq=change_seq, erased_at=now)
        for digest in sorted(set(digests) - existing)
    )
    session.flush()


def tombstones_among(session: Session, kind: str, digests: Collection[str]) -> set[str]:
    """Return the digests that have a tombstone of this kind."""
    return _among(session, Tombstone.digest, digests, Tombstone.kind == kind)


def tombstone_digests(session: Session, kind: str) -> Iterator[str]:
    """Stream the digests of all tombstones of this kind."""
    yield from session.scalars(
        sa.select(Tombstone.digest).where(Tombstone.kind == kind).execution_options(yield_per=1000)
    )


def participant_ids(session: Session) -> Iterator[uuid.UUID]:
    """Stream the ids of all participants."""
    yield from session.scalars(sa.select(Participant.id).execution_options(yield_per=1000))


def schedule_deletion(session: Session, keys: Collection[str], now: datetime) -> None:
    """Schedule blobs for deletion; a key that ends with a slash means all blobs below it."""
    new = set(keys) - _among(session, BlobDeletion.blob_key, keys)
    session.add_all(BlobDeletion(blob_key=key, requested_at=now) for key in sorted(new))
    session.flush()


def scheduled_deletions(session: Session, limit: int) -> list[str]:
    """Return the keys of blobs to delete, the oldest first."""
    query = (
        sa.select(BlobDeletion.blob_key)
        .order_by(BlobDeletion.requested_at, BlobDeletion.blob_key)
        .limit(limit)
    )
    return list(session.scalars(query))


def remove_scheduled_deletions(session: Session, keys: Collection[str]) -> None:
    """Remove deletions that were carried out."""
    session.execute(sa.delete(BlobDeletion).where(BlobDeletion.blob_key.in_(keys)))


def page_of_audit(
    session: Session,
    chosen: AuditFilter,
    *,
    after: int | None,
    limit: int,
    is_newest_first: bool = False,
) -> list[AuditRow]:
    """Return at most `limit` events in order, after the id `after`."""
    event = AuditEvent
    query = (
        sa.select(
            event.id,
            event.at,
            Study.code,
            event.actor_kind,
            event.actor,
            event.action,
            event.subject,
            event.details,
            event.request_id,
        )
        .outerjoin(Study, Study.id == event.study_id)
        .order_by(event.id.desc() if is_newest_first else event.id)
        .limit(limit)
    )
    if chosen.study_id is not None:
        query = query.where(event.study_id == chosen.study_id)
    if chosen.action is not None:
        query = query.where(event.action == chosen.action)
    if chosen.since is not None:
        query = query.where(event.at >= chosen.since)
    if chosen.until is not None:
        query = query.where(event.at < chosen.until)
    if after is not None:
        query = query.where(event.id < after if is_newest_first else event.id > after)
    return [AuditRow(*row) for row in session.execute(query)]


def _among(
    session: Session,
    column: InstrumentedAttribute[str],
    values: Collection[str],
    *where: sa.ColumnElement[bool],
) -> set[str]:
    """Return the values that the column contains."""
    present: set[str] = set()
    ordered = sorted(values)
    for start in range(0, len(ordered), IN_A_STATEMENT):
        part = ordered[start : start + IN_A_STATEMENT]
        present.update(session.scalars(sa.select(column).where(column.in_(part), *where)))
    return present


def locked_deployment(session: Session) -> Deployment:
    """Return the row, locked until the transaction ends."""
    return session.get_one(Deployment, DEPLOYMENT, with_for_update=True, populate_existing=True)


def clock_doubted_seconds(session: Session) -> float:
    """Return how long the workers must still run until the clock is trusted; 0: it is trusted."""
    return session.get_one(Deployment, DEPLOYMENT).clock_doubted_seconds


def key_check(session: Session) -> str | None:
    """Return the digest by the secret key that the database was first used with; None: by none yet."""
    return session.scalar(sa.select(Deployment.key_check))


def keep_key_check(session: Session, check: str) -> None:
    """Keep the digest unless another process has kept one meanwhile."""
    deployment = locked_deployment(session)
    deployment.key_check = deployment.key_check or check
