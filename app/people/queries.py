"""SQL of studies, participants, devices, staff, enrolments and tokens."""

import uuid
from collections.abc import Collection
from datetime import datetime
from typing import TypeVarTuple

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.people.models import AccessToken, Device, Enrolment, Participant, Role, Staff, Study, StudyMember
from app.people.privacy_models import Tombstone

Rows = TypeVarTuple("Rows")

_TOKEN = (  # built once: every call asks
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
            sa.func.coalesce(AccessToken.last_used_at, AccessToken.created_at) > sa.bindparam("idle_since"),
        ),
    )
)

MEAL = sa.table(
    "meal", sa.column("study_id", sa.Uuid())
)  # of a higher domain, meals, whose models are not imported here


def find_token(
    session: Session, token_sha256: str, now: datetime, *, idle_since: datetime
) -> sa.Row[AccessToken, Staff, Device, Participant] | None:
    """A token that is valid now, with its owner, or None: neither it, its device nor its owner may be shut out.

    idle_since: a session must have been used, or opened, after it.
    """
    values = {"token_sha256": token_sha256, "now": now, "idle_since": idle_since}
    return session.execute(_TOKEN, values).one_or_none()


def roles_of(session: Session, staff_id: uuid.UUID) -> dict[uuid.UUID, Role]:
    """Study -> role of a staff member."""
    query = sa.select(StudyMember.study_id, StudyMember.role).where(StudyMember.staff_id == staff_id)
    return {row.study_id: row.role for row in session.execute(query)}


def has_tombstone(session: Session, kind: str, digest: str) -> bool:
    """Whether something of this name was here and is erased."""
    return session.get(Tombstone, (kind, digest)) is not None


def find_study(session: Session, code: str, *, lock: bool = False) -> Study | None:
    """The study of this code; lock: nobody else changes it until commit."""
    return session.scalars(_locked(sa.select(Study).where(Study.code == code), lock)).one_or_none()


def page_of_studies(
    session: Session, known: frozenset[uuid.UUID] | None, *, after: str | None, limit: int
) -> list[Study]:
    """Studies by code, those behind `after`. known: only these; None: all."""
    query = sa.select(Study) if known is None else sa.select(Study).where(Study.id.in_(known))
    return list(session.scalars(_behind(query, Study.code, after, limit)))


def known_study_codes(session: Session, known: frozenset[uuid.UUID] | None) -> list[str]:
    """The codes of studies, sorted. known: only of these; None: of all."""
    query = sa.select(Study.code).order_by(Study.code)
    return list(session.scalars(query if known is None else query.where(Study.id.in_(known))))


def codes_of_studies(session: Session, study_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, str]:
    """Study -> code."""
    rows = session.execute(sa.select(Study.id, Study.code).where(Study.id.in_(study_ids)))
    return {row.id: row.code for row in rows}


def has_meals(session: Session, study_id: uuid.UUID) -> bool:
    """Whether a meal of the study is kept, or was deleted and left its row."""
    return session.execute(sa.select(MEAL.c.study_id).where(MEAL.c.study_id == study_id).limit(1)).first() is not None


def find_participant(session: Session, study_id: uuid.UUID, code: str, *, lock: bool = False) -> Participant | None:
    """The participant of this code in a study; lock: nobody else changes the row until commit."""
    query = sa.select(Participant).where(Participant.study_id == study_id, Participant.code == code)
    return session.scalars(_locked(query, lock)).one_or_none()


def page_of_participants(session: Session, study_id: uuid.UUID, *, after: str | None, limit: int) -> list[Participant]:
    """Participants of a study by code, those behind `after`."""
    query = sa.select(Participant).where(Participant.study_id == study_id)
    return list(session.scalars(_behind(query, Participant.code, after, limit)))


def page_of_devices(
    session: Session,
    study_id: uuid.UUID,
    participant_code: str | None,
    *,
    after: tuple[datetime, uuid.UUID] | None,
    limit: int,
) -> list[tuple[Device, str]]:
    """(device, its participant's code) of a study, the last enrolled first, those behind `after`."""
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
        query = query.where(sa.tuple_(Device.enrolled_at, Device.id) < sa.tuple_(enrolled_at, device_id))
    return [(device, code) for device, code in session.execute(query)]


def end_tokens_of_device(session: Session, device_id: uuid.UUID, now: datetime) -> None:
    """Revoke a device's tokens."""
    session.execute(
        sa.update(AccessToken)
        .where(AccessToken.device_id == device_id, AccessToken.revoked_at.is_(None))
        .values(revoked_at=now)
    )


def find_staff(session: Session, name: str, *, lock: bool = False) -> Staff | None:
    """The staff member of this name; lock: nobody else changes the row until commit."""
    return session.scalars(_locked(sa.select(Staff).where(Staff.name == name), lock)).one_or_none()


def page_of_staff(session: Session, *, after: str | None, limit: int) -> list[Staff]:
    """Staff by name, those behind `after`."""
    return list(session.scalars(_behind(sa.select(Staff), Staff.name, after, limit)))


def lock_active_admins(session: Session) -> list[Staff]:
    """The admins who are not disabled; nobody else changes them until commit."""
    query = sa.select(Staff).where(Staff.is_admin, Staff.disabled_at.is_(None)).order_by(Staff.id)
    return list(session.scalars(_locked(query, True)))


def page_of_members(
    session: Session, study_id: uuid.UUID, *, after: str | None, limit: int
) -> list[tuple[StudyMember, Staff]]:
    """A study's members by name, those behind `after`."""
    query = (
        sa.select(StudyMember, Staff)
        .join(Staff, Staff.id == StudyMember.staff_id)
        .where(StudyMember.study_id == study_id)
    )
    return [(member, staff) for member, staff in session.execute(_behind(query, Staff.name, after, limit))]


def active_owners(session: Session, study_id: uuid.UUID) -> set[uuid.UUID]:
    """The study's owners who are not disabled."""
    query = (
        sa.select(StudyMember.staff_id)
        .join(Staff, Staff.id == StudyMember.staff_id)
        .where(StudyMember.study_id == study_id, StudyMember.role == "owner", Staff.disabled_at.is_(None))
    )
    return set(session.scalars(query))


def end_access_of_staff(session: Session, staff_id: uuid.UUID, now: datetime) -> list[AccessToken]:
    """Revoke all sessions and personal tokens of a staff member that still open something."""
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
    """A staff member's own tokens that are valid, the newest first."""
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


def forget_sessions(session: Session, staff_id: uuid.UUID, before: datetime) -> None:
    """Delete a staff member's sessions that ended before then; the audit log keeps that they were."""
    session.execute(
        sa.delete(AccessToken).where(
            AccessToken.staff_id == staff_id, AccessToken.kind == "session", AccessToken.expires_at < before
        )
    )


def end_enrolments(session: Session, participant_id: uuid.UUID, now: datetime) -> None:
    """End a participant's codes that were not used."""
    session.execute(
        sa.update(Enrolment)
        .where(Enrolment.participant_id == participant_id, Enrolment.used_at.is_(None), Enrolment.expires_at > now)
        .values(expires_at=now)
    )


def whose_enrolment(session: Session, code_sha256: str) -> uuid.UUID | None:
    """The participant of a code, whether it is valid or not; None: there is no such code."""
    return session.scalars(
        sa.select(Enrolment.participant_id).where(Enrolment.code_sha256 == code_sha256)
    ).one_or_none()


def take_enrolment(session: Session, code_sha256: str, now: datetime) -> Enrolment | None:
    """Mark a valid code as used and return it; None if it is unknown, used or expired. Of two callers one wins."""
    query = (
        sa.update(Enrolment)
        .where(Enrolment.code_sha256 == code_sha256, Enrolment.used_at.is_(None), Enrolment.expires_at > now)
        .values(used_at=now)
        .returning(Enrolment)
    )
    return session.scalars(query).one_or_none()


def note_device(
    session: Session, device_id: uuid.UUID, at: datetime, clock_skew_seconds: float | None, app_version: str | None
) -> None:
    """When a phone was last used and how its clock stood then; its app's version, where it is told.

    Written after the call: a phone that was revoked by it, perhaps anonymised, stays as it is.
    """
    values: dict[str, object] = {"last_used_at": at, "clock_skew_seconds": clock_skew_seconds}
    if app_version is not None:
        values["app_version"] = app_version
    session.execute(sa.update(Device).where(Device.id == device_id, Device.revoked_at.is_(None)).values(values))


def note_token(session: Session, token_id: uuid.UUID, at: datetime) -> None:
    """When a token was last used."""
    session.execute(sa.update(AccessToken).where(AccessToken.id == token_id).values(last_used_at=at))


def note_app_version(session: Session, device_id: uuid.UUID, app_version: str) -> None:
    """The version that a phone's meal tells."""
    session.execute(sa.update(Device).where(Device.id == device_id).values(app_version=app_version))


def _behind(
    query: sa.Select[*Rows], column: InstrumentedAttribute[str], after: str | None, limit: int
) -> sa.Select[*Rows]:
    """The rows of a query by a column, those behind a value of it."""
    query = query.order_by(column).limit(limit)
    return query if after is None else query.where(column > after)


def _locked(query: sa.Select[*Rows], lock: bool) -> sa.Select[*Rows]:
    """PostgreSQL locks the rows until commit; on SQLite there is one writer anyway."""
    return query.with_for_update() if lock else query
