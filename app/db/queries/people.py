"""SQL of studies, participants, devices, staff, enrolments and tokens."""

import uuid
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import AccessToken, Device, Enrolment, Participant, Staff, Study, StudyMember, Tombstone


def find_token(
    session: Session, token_sha256: str, now: datetime, *, idle_since: datetime
) -> sa.Row[*tuple[Any, ...]] | None:
    """A token that is valid now, with its owner, or None: neither it, its device nor its owner may be shut out.

    idle_since: a session must have been used, or opened, after it.
    """
    query = (
        sa.select(
            AccessToken.id.label("token_id"),
            AccessToken.kind,
            AccessToken.scope,
            AccessToken.study_id.label("only_study_id"),
            AccessToken.staff_id,
            Staff.name.label("staff_name"),
            Staff.is_admin,
            AccessToken.device_id,
            Device.participant_id,
            Participant.study_id,
            Participant.alias.label("participant_alias"),
        )
        .outerjoin(Staff, Staff.id == AccessToken.staff_id)
        .outerjoin(Device, Device.id == AccessToken.device_id)
        .outerjoin(Participant, Participant.id == Device.participant_id)
        .where(
            AccessToken.token_sha256 == token_sha256,
            AccessToken.revoked_at.is_(None),
            Staff.disabled_at.is_(None),
            Device.revoked_at.is_(None),
            sa.or_(AccessToken.expires_at.is_(None), AccessToken.expires_at > now),
            sa.or_(
                AccessToken.kind != "session",
                sa.func.coalesce(AccessToken.last_used_at, AccessToken.created_at) > idle_since,
            ),
        )
    )
    return session.execute(query).one_or_none()


def roles_of(session: Session, staff_id: uuid.UUID) -> dict[uuid.UUID, Any]:
    """Study -> role of a staff member."""
    query = sa.select(StudyMember.study_id, StudyMember.role).where(StudyMember.staff_id == staff_id)
    return {row.study_id: row.role for row in session.execute(query)}


def has_tombstone(session: Session, kind: str, digest: str) -> bool:
    """Whether something of this name was here and is erased."""
    return session.get(Tombstone, (kind, digest)) is not None


def find_study(session: Session, code: str) -> Study | None:
    """The study of this code."""
    return session.scalars(sa.select(Study).where(Study.code == code)).one_or_none()


def list_studies(session: Session) -> list[Study]:
    """All studies by code."""
    return list(session.scalars(sa.select(Study).order_by(Study.code)))


def find_participant(session: Session, study_id: uuid.UUID, code: str) -> Participant | None:
    """The participant of this code in a study."""
    query = sa.select(Participant).where(Participant.study_id == study_id, Participant.code == code)
    return session.scalars(query).one_or_none()


def find_staff(session: Session, name: str) -> Staff | None:
    """The staff member of this name."""
    return session.scalars(sa.select(Staff).where(Staff.name == name)).one_or_none()


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
    """When a phone was last used and how its clock stood then; its app's version, where it is told."""
    values = {"last_used_at": at, "clock_skew_seconds": clock_skew_seconds}
    if app_version is not None:
        values["app_version"] = app_version
    session.execute(sa.update(Device).where(Device.id == device_id).values(values))


def note_token(session: Session, token_id: uuid.UUID, at: datetime) -> None:
    """When a token was last used."""
    session.execute(sa.update(AccessToken).where(AccessToken.id == token_id).values(last_used_at=at))
