"""Who works in a study, and as what. A study never loses its last owner."""

import uuid
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.http.paging import TEXT, Page, decode_cursor, page_of
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import StaffCaller
from app.people.access.staff import known_staff, normal_name
from app.people.models import Role, Staff, Study, StudyMember
from app.people.studies import known_study


@dataclass(frozen=True, slots=True)
class Membership:
    """A staff member's role in a study."""

    name: str
    role: str
    is_disabled: bool
    since: datetime


def list_members(database: Database, study_code: str, *, cursor: str | None, limit: int) -> Page[Membership]:
    """A study's members by name. Raises NotFoundError."""
    listed = f"members of {study_code}"
    after = decode_cursor(listed, cursor, TEXT)
    with database.read() as session:
        study = known_study(people.find_study(session, study_code))
        rows = people.page_of_members(session, study.id, after=after, limit=limit + 1)
    return page_of(listed, [_membership(member, staff) for member, staff in rows], limit, lambda row: row.name)


def set_member(database: Database, caller: StaffCaller, study_code: str, name: str, role: Role) -> Membership:
    """Give somebody a role in a study, or another one. Raises NotFoundError, ConflictError (`last_owner`)."""
    with database.write() as session:
        study, staff, member = _find(session, study_code, name)
        if staff.disabled_at is not None:
            raise NotFoundError("There is no such staff member.")
        if member is None:
            member = StudyMember(study_id=study.id, staff_id=staff.id, role=role, created_at=datetime.now(UTC))
            session.add(member)
        elif member.role != role:
            _keep_an_owner(session, study.id, staff.id, member.role)
            member.role = role
        note(session, caller, "member.set", study_id=study.id, subject=staff.name, role=role)
        return _membership(member, staff)


def remove_member(database: Database, caller: StaffCaller, study_code: str, name: str) -> None:
    """Take somebody out of a study; their tokens reach it no more. Raises NotFoundError, ConflictError."""
    with database.write() as session:
        study, staff, member = _find(session, study_code, name)
        if member is None:
            raise NotFoundError("There is no such member of the study.")
        _keep_an_owner(session, study.id, staff.id, member.role)
        session.delete(member)
        note(session, caller, "member.remove", study_id=study.id, subject=staff.name)


def _find(session: Session, study_code: str, name: str) -> tuple[Study, Staff, StudyMember | None]:
    """Study, staff member and membership; the study's row is locked, so that two owners cannot remove each other."""
    study = known_study(people.find_study(session, study_code, lock=True))
    staff = known_staff(people.find_staff(session, normal_name(name)))
    return study, staff, session.get(StudyMember, (study.id, staff.id))


def _keep_an_owner(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID, role: str) -> None:
    if role == "owner" and not people.active_owners(session, study_id) - {staff_id}:
        raise ConflictError("This is the study's last owner: make another one first.", code="last_owner")


def _membership(member: StudyMember, staff: Staff) -> Membership:
    return Membership(staff.name, member.role, staff.disabled_at is not None, member.created_at)
