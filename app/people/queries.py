"""SQL of studies, participants, devices, staff, enrolments and tokens."""

import uuid
from collections.abc import Collection
from datetime import datetime
from typing import TypeVarTuple

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.people.models import (
    AccessToken,
    Device,
    Enrolment,
    Participant,
    PushSubscription,
    Role,
    Staff,
    Study,
    StudyMember,
)
from app.people.privacy_models import ErasedKind, ErasureReceipt, Tombstone

Rows = TypeVarTuple("Rows")

_TOKEN = (  # built once, since every request uses it
    sa.select(AccessToken, Staff, Device, Participant)
    .outerjoin(Staff, Staff.id == AccessToken.staff_id)
    .outerjoin(Device, Device.id == AccessToken.device_id)
    .outerjoin(Participant, Participant.id == Device.participant_id)
    .where(
        AccessToken.token_sha256 == sa.bindparam("token_sha256"),
        AccessToken.revoked_at.is_(None),
        Staff.disabled_at.is_(None),
        Device.revoked_at.is_(None),
        sa.or_(AccessToken.expires_at.is_(None), AccessToken.expires_at > sa.bindparam("now")),
        sa.or_(
            AccessToken.kind != "session",
            sa.func.coalesce(AccessToken.last_used_at, AccessToken.created_at)
            > sa.bindparam("idle_since"),
        ),
    )
)

# the models of meals, a higher domain, cannot be imported
MEAL = sa.table("meal", sa.column("study_id", sa.Uuid()))


def find_token(
    session: Session, token_sha256: str, now: datetime, *, idle_since: datetime
) -> sa.Row[AccessToken, Staff, Device, Participant] | None:
    """Return a token and its owner; None if it is expired or revoked, or its device or staff member is.

    idle_since: a session must have been used or opened after this time.
    """
    values = {"token_sha256": token_sha256, "now": now, "idle_since": idle_since}
    return session.execute(_TOKEN, values).one_or_none()


def is_token_used(session: Session, token_sha256: str, tombstone: str) -> bool:
    """Return true if a token was ever issued.

    tombstone: the digest that it has if its participant was erased.
    """
    issued = sa.select(AccessToken.id).where(AccessToken.token_sha256 == token_sha256)
    return (
        session.scalar(issued) is not None
        or find_tombstone(session, "token", tombstone) is not None
    )


def roles_of(session: Session, staff_id: uuid.UUID) -> dict[uuid.UUID, Role]:
    """Return a staff member's role by study."""
    query = sa.select(StudyMember.study_id, StudyMember.role).where(
        StudyMember.staff_id == staff_id
    )
    return {row.study_id: row.role for row in session.execute(query)}


def find_tombstone(session: Session, kind: str, digest: str) -> Tombstone | None:
    """Return the tombstone of something that was erased; None if nothing with this digest was."""
    return session.get(Tombstone, (kind, digest))


def receipt_of_erasure(
    session: Session, tombstone: Tombstone, what: ErasedKind
) -> uuid.UUID | None:
    """Return the receipt of the erasure that left a tombstone: one transaction wrote both, with one time."""
    query = sa.select(ErasureReceipt.id).where(
        ErasureReceipt.study_id == tombstone.study_id,
        ErasureReceipt.what == what,
        ErasureReceipt.erased_at == tombstone.erased_at,
    )
    receipts = session.scalars(query).all()
    return receipts[0] if len(receipts) == 1 else None


def find_study(session: Session, code: str, *, lock: bool = False) -> Study | None:
    """Return the study with a code. lock: nobody else changes it until commit."""
    return session.scalars(_locked(sa.select(Study).where(Study.code == code), lock)).one_or_none()


def page_of_studies(
    session: Session, study_ids: frozenset[uuid.UUID] | None, *, after: str | None, limit: int
) -> list[Study]:
    """Return studies by code, after the code `after`. study_ids: None for all."""
    query = (
        sa.select(Study) if study_ids is None else sa.select(Study).where(Study.id.in_(study_ids))
    )
    return list(session.scalars(_page_after(query, Study.code, after, limit)))


def study_codes(session: Session, study_ids: frozenset[uuid.UUID] | None) -> list[str]:
    """Return the codes of studies, sorted. study_ids: None for all."""
    query = sa.select(Study.code).order_by(Study.code)
    return list(
        session.scalars(query if study_ids is None else query.where(Study.id.in_(study_ids)))
    )


def web_origins(session: Session) -> list[tuple[uuid.UUID, list[str]]]:
    """Return the studies that allow web apps, with their origins."""
    query = sa.select(Study.id, Study.web_origins).where(Study.web_origins.is_not(None))
    return [(row.id, row.web_origins) for row in session.execute(query)]


def sandboxes(session: Session) -> frozenset[uuid.UUID]:
    """Return the sandbox studies."""
    return frozenset(session.scalars(sa.select(Study.id).where(Study.is_sandbox)))


def codes_of_studies(session: Session, study_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, str]:
    """Return the code of each study."""
    rows = session.execute(sa.select(Study.id, Study.code).where(Study.id.in_(study_ids)))
    return {row.id: row.code for row in rows}


def has_meals(session: Session, study_id: uuid.UUID) -> bool:
    """Whether the study has a meal."""
    return (
        session.execute(
            sa.select(MEAL.c.study_id).where(MEAL.c.study_id == study_id).limit(1)
        ).first()
        is not None
    )


def unschedule_reminders(session: Session, study_id: uuid.UUID) -> None:
    """Make the worker schedule the phones that follow their study's reminder times anew."""
    devices = sa.select(Device.id).join(Participant).where(Participant.study_id == study_id)
    session.execute(
        sa.update(PushSubscription)
        .where(PushSubscription.times.is_(None), PushSubscription.device_id.in_(devices))
        .values(next_at=None)
        .execution_options(synchronize_session=False)
    )


def find_participant(
    session: Session, study_id: uuid.UUID, code: str, *, lock: bool = False
) -> Participant | None:
    """Return the participant with a code in a study.

    lock: nobody else changes the row until commit.
    """
    query = sa.select(Participant).where(Participant.study_id == study_id, Participant.code == code)
    return session.scalars(_locked(query, lock)).one_or_none()


def page_of_participants(
    session: Session, study_id: uuid.UUID, *, after: str | None, limit: int
) -> list[Participant]:
    """Return participants of a study by code, after the code `after`."""
    query = sa.select(Participant).where(Participant.study_id == study_id)
    return list(session.scalars(_page_after(query, Participant.code, after, limit)))


def page_of_devices(
    session: Session,
    study_id: uuid.UUID,
    participant_code: str | None,
    *,
    after: tuple[datetime, uuid.UUID] | None,
    limit: int,
) -> list[tuple[Device, str]]:
    """Return (device, its participant's code) of a study after `after`, the last enrolled first."""
    query = (
        sa.select(Device, Participant.code)
        .join(Participant, Participant.id == Device.participant_id)
        .where(Participant.study_id == study_id)
        .order_by(Device.enrolled_at.desc(), Device.id.desc())
        .limit(limit)
    )
    if participant_code is not None:
        query = query.where(Participant.code == participant_code)
    if after is not None:
        enrolled_at = sa.bindparam(None, after[0], type_=Device.enrolled_at.type)
        device_id = sa.bindparam(None, after[1], type_=Device.id.type)
        query = query.where(
            sa.tuple_(Device.enrolled_at, Device.id) < sa.tuple_(enrolled_at, device_id)
        )
    return [(device, code) for device, code in session.execute(query)]


def first_enrolment(session: Session, participant_id: uuid.UUID) -> datetime:
    """Return when the participant's first phone was enrolled. Raises NoResultFound without one."""
    query = sa.select(Device.enrolled_at).where(Device.participant_id == participant_id)
    return session.scalars(query.order_by(Device.enrolled_at).limit(1)).one()


def end_tokens_of_device(session: Session, device_id: uuid.UUID, now: datetime) -> None:
    """Revoke a device's tokens, and end its reminders."""
    session.execute(sa.delete(PushSubscription).where(PushSubscription.device_id == device_id))
    session.execute(
        sa.update(AccessToken)
        .where(AccessToken.device_id == device_id, AccessToken.revoked_at.is_(None))
        .values(revoked_at=now)
    )


def find_staff(session: Session, name: str, *, lock: bool = False) -> Staff | None:
    """Return the staff member with a name. lock: nobody else changes the row until commit."""
    return session.scalars(_locked(sa.select(Staff).where(Staff.name == name), lock)).one_or_none()


def find_staff_by_identity(session: Session, identity: str) -> Staff | None:
    """Return the staff member who linked this identity, locked until commit."""
    query = sa.select(Staff).where(Staff.oidc_identity == identity)
    return session.scalars(_locked(query, True)).one_or_none()


def page_of_staff(session: Session, *, after: str | None, limit: int) -> list[Staff]:
    """Return staff by name, after the name `after`."""
    return list(session.scalars(_page_after(sa.select(Staff), Staff.name, after, limit)))


def lock_active_admins(session: Session) -> list[Staff]:
    """Return the admins who are not disabled, locked until commit."""
    query = sa.select(Staff).where(Staff.is_admin, Staff.disabled_at.is_(None)).order_by(Staff.id)
    return list(session.scalars(_locked(query, True)))


def page_of_members(
    session: Session, study_id: uuid.UUID, *, after: str | None, limit: int
) -> list[tuple[StudyMember, Staff]]:
    """Return a study's members by name, after the name `after`."""
    query = (
        sa.select(StudyMember, Staff)
        .join(Staff, Staff.id == StudyMember.staff_id)
        .where(StudyMember.study_id == study_id)
    )
    return [
        (member, staff)
        for member, staff in session.execute(_page_after(query, Staff.name, after, limit))
    ]


def active_owners(session: Session, study_id: uuid.UUID) -> set[uuid.UUID]:
    """Return the study's owners who are not disabled."""
    query = (
        sa.select(StudyMember.staff_id)
        .join(Staff, Staff.id == StudyMember.staff_id)
        .where(
            StudyMember.study_id == study_id,
            StudyMember.role == "owner",
            Staff.disabled_at.is_(None),
        )
    )
    return set(session.scalars(query))


def end_access_of_staff(session: Session, staff_id: uuid.UUID, now: datetime) -> list[AccessToken]:
    """Revoke all valid sessions and personal tokens of a staff member. Returns them."""
    query = (
        sa.update(AccessToken)
        .where(
            AccessToken.staff_id == staff_id,
            AccessToken.revoked_at.is_(None),
            sa.or_(AccessToken.expires_at.is_(None), AccessToken.expires_at > now),
        )
        .values(revoked_at=now)
        .returning(AccessToken)
    )
    return list(session.scalars(query))


def personal_tokens(session: Session, staff_id: uuid.UUID, now: datetime) -> list[AccessToken]:
    """Return a staff member's valid personal tokens, the newest first."""
    query = (
        sa.select(AccessToken)
        .where(
            AccessToken.staff_id == staff_id,
            AccessToken.kind == "personal",
            AccessToken.revoked_at.is_(None),
            sa.or_(AccessToken.expires_at.is_(None), AccessToken.expires_at > now),
        )
        .order_by(AccessToken.created_at.desc(), AccessToken.id)
    )
    return list(session.scalars(query))


def delete_sessions(session: Session, staff_id: uuid.UUID, before: datetime) -> None:
    """Delete a staff member's sessions that ended before a time; the audit log still has them."""
    session.execute(
        sa.delete(AccessToken).where(
            AccessToken.staff_id == staff_id,
            AccessToken.kind == "session",
            AccessToken.expires_at < before,
        )
    )


def end_enrolments(session: Session, participant_id: uuid.UUID, now: datetime) -> None:
    """End a participant's unused enrolment codes."""
    session.execute(
        sa.update(Enrolment)
        .where(
            Enrolment.participant_id == participant_id,
            Enrolment.used_at.is_(None),
            Enrolment.expires_at > now,
        )
        .values(expires_at=now)
    )


def participant_of_code(session: Session, code_sha256: str) -> uuid.UUID | None:
    """Return the participant of an enrolment code, valid or not; None if there is no such code."""
    return session.scalars(
        sa.select(Enrolment.participant_id).where(Enrolment.code_sha256 == code_sha256)
    ).one_or_none()


def take_enrolment(session: Session, code_sha256: str, now: datetime) -> Enrolment | None:
    """Mark a valid code as used and return it, to one caller only; None if it is unknown, used or expired.

    The code of a sandbox study stays unused.
    """
    of_sandbox = (
        sa.select(Study.id)
        .join(Participant, Participant.study_id == Study.id)
        .where(Participant.id == Enrolment.participant_id, Study.is_sandbox)
        .exists()
    )
    query = (
        sa.update(Enrolment)
        .where(
            Enrolment.code_sha256 == code_sha256,
            Enrolment.used_at.is_(None),
            Enrolment.expires_at > now,
        )
        .values(used_at=sa.case((of_sandbox, None), else_=now))
        .returning(Enrolment)
    )
    return session.scalars(query).one_or_none()


def note_device(
    session: Session,
    device_id: uuid.UUID,
    at: datetime,
    clock_skew_seconds: float | None,
    app_version: str | None,
) -> None:
    """Store when a phone was last used, its clock's skew and, if given, its app's version.

    It runs after the request, so a phone that the request revoked, or anonymised, is left
    unchanged.
    """
    values: dict[str, object] = {"last_used_at": at, "clock_skew_seconds": clock_skew_seconds}
    if app_version is not None:
        values["app_version"] = app_version
    session.execute(
        sa.update(Device).where(Device.id == device_id, Device.revoked_at.is_(None)).values(values)
    )


def note_token(session: Session, token_id: uuid.UUID, at: datetime) -> None:
    """Store when a token was last used."""
    session.execute(
        sa.update(AccessToken).where(AccessToken.id == token_id).values(last_used_at=at)
    )


def note_app_version(session: Session, device_id: uuid.UUID, app_version: str) -> None:
    """Store the app version that a meal was sent with."""
    session.execute(sa.update(Device).where(Device.id == device_id).values(app_version=app_version))


def _page_after(
    query: sa.Select[*Rows], column: InstrumentedAttribute[str], after: str | None, limit: int
) -> sa.Select[*Rows]:
    """Order a query by a column and limit it to the rows after a value."""
    query = query.order_by(column).limit(limit)
    return query if after is None else query.where(column > after)


def _locked(query: sa.Select[*Rows], lock: bool) -> sa.Select[*Rows]:
    """Lock the rows until commit on PostgreSQL; SQLite has one writer anyway."""
    return query.with_for_update() if lock else query
