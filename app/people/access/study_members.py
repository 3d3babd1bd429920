"""List, add and remove a study's members; the last owner cannot be removed or lose the role."""

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
from app.people.access.staff import load_staff
from app.people.models import Role, Staff, Study, StudyMember
from app.people.studies import load_study


@dataclass(frozen=True, slots=True)
class Membership:
    """A staff member's role in a study."""

    name: str
    role: str
    is_disabled: bool
    since: datetime


def list_members(
    database: Database, study_code: str, *, cursor: str | None, limit: int
) -> Page[Membership]:
    """Return a page of a study's members by name. Raises NotFoundError."""
    list_name = f"members of {study_code}"
    after = decode_cursor(list_name, cursor, TEXT)
    with database.read() as session:
        study = load_study(session, study_code)
        rows = people.page_of_members(session, study.id, after=after, limit=limit + 1)
    return page_of(
        list_name,
        [_membership(member, staff) for member, staff in rows],
        limit,
        lambda row: row.name,
    )


def set_member(
    database: Database, caller: StaffCaller, study_code: str, name: str, role: Role
) -> Membership:
    """Give a staff member a role in a study or change it. Raises NotFoundError, ConflictError (`last_owner`)."""
    with database.write() as session:
        study, staff, member = _find(session, study_code, name)
        if staff.disabled_at is not None:
            raise NotFoundError("There is no such staff member.")
        if member is None:
            member = StudyMember(
                study_id=study.id, staff_id=staff.id, role=role, created_at=datetime.now(UTC)
            )
            session.add(member)
        elif member.role != role:
            _require_other_owner(session, study.id, staff.id, member.role)
            member.role = role
        note(session, caller, "member.set", study_id=study.id, subject=staff.name, role=role)
        return _membership(member, staff)


def remove_member(database: Database, caller: StaffCaller, study_code: str, name: str) -> None:
    """Remove a member from a study, which their tokens no longer reach. Raises NotFoundError, ConflictError."""
    with database.write() as session:
        study, staff, member = _find(session, study_code, name)
        if member is None:
            raise NotFoundError("There is no such member of the study.")
        _require_other_owner(session, study.id, staff.id, member.role)
        session.delete(member)
        note(session, caller, "member.remove", study_id=study.id, subject=staff.name)


def _find(session: Session, study_code: str, name: str) -> tuple[Study, Staff, StudyMember | None]:
    """Return study, staff member and membership; the study is locked, so that two owners cannot remove each other."""
    study = load_study(session, study_code, lock=True)
    staff = load_staff(session, name)
    return study, staff, session.get(StudyMember, (study.id, staff.id))


def _require_other_owner(
    session: Session, study_id: uuid.UUID, staff_id: uuid.UUID, role: str
) -> None:
    if role == "owner" and not people.active_owners(session, study_id) - {staff_id}:
        raise ConflictError(
            "This is the study's last owner: add another owner first.", code="last_owner"
        )


def _membership(member: StudyMember, staff: Staff) -> Membership:
    return Membership(staff.name, member.role, staff.disabled_at is not None, member.created_at)
