"""Create, list, change and disable staff, and give them roles in studies.

The last admin, and a study's last owner, cannot be disabled, removed or lose the role.
"""

import unicodedata
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.db.session import Database, unless_taken
from app.http.paging import TEXT, Page, decode_cursor, page_of
from app.people import queries as people
from app.people.access.access_tokens import EndedAccess, end_access
from app.people.access.audit import note
from app.people.access.caller import Caller, StaffCaller, new_token, sha256_hex
from app.people.access.passwords import Passwords
from app.people.access.staff_schemas import MemberOut
from app.people.models import AccessToken, Role, Staff, Study, StudyMember
from app.people.studies import load_study

NAME_LENGTH = 100


@dataclass(frozen=True, slots=True)
class StaffChange:
    """A change of a staff member; None leaves a field unchanged.

    Disabling, or replacing a password, ends all sessions and tokens. ends_totp: signing in needs no
    code any more.
    """

    is_admin: bool | None = None
    is_disabled: bool | None = None
    password: str | None = None
    ends_totp: bool = False


@dataclass(frozen=True, slots=True)
class ChangedStaff:
    """A staff member after a change, and the sessions and tokens that it ended."""

    staff: Staff
    ended: EndedAccess


def create_admin(database: Database, name: str) -> str:
    """Create an admin for the command line and return their personal token.

    Raises ConflictError.
    """
    token = new_token()
    with unless_taken(_exists_error(name)), database.write() as session:
        staff = _add(session, None, name, is_admin=True, password_hash=None)
        session.add(
            AccessToken(
                id=uuid.uuid4(),
                token_sha256=sha256_hex(token),
                kind="personal",
                name="made with the admin",
                staff_id=staff.id,
                created_at=datetime.now(UTC),
            ),
        )
    return token


def create_staff(
    database: Database,
    passwords: Passwords,
    name: str,
    *,
    is_admin: bool,
    password: str | None,
    caller: Caller | None = None,
) -> Staff:
    """Create a staff member, who cannot sign in without a password.

    Raises ConflictError (`staff_exists`), InvalidInputError (`password_refused`).
    """
    hashed = passwords.hash(password, name=name) if password is not None else None
    with unless_taken(_exists_error(name)), database.write() as session:
        return _add(session, caller, name, is_admin=is_admin, password_hash=hashed)


def list_staff(database: Database, *, cursor: str | None, limit: int) -> Page[Staff]:
    """Return a page of all staff by name, including disabled ones."""
    after = decode_cursor("staff", cursor, TEXT)
    with database.read() as session:
        rows = people.page_of_staff(session, after=after, limit=limit + 1)
    return page_of("staff", rows, limit, lambda staff: staff.name)


def read_staff(database: Database, name: str) -> Staff:
    """Return a staff member. Raises NotFoundError."""
    with database.read() as session:
        return load_staff(session, name)


def change_staff(
    database: Database,
    passwords: Passwords,
    name: str,
    change: StaffChange,
    caller: Caller | None = None,
) -> ChangedStaff:
    """Change a staff member.

    Raises NotFoundError, ConflictError (`last_admin`), InvalidInputError (`password_refused`).
    """
    now = datetime.now(UTC)
    hashed = passwords.hash(change.password, name=name) if change.password is not None else None
    with database.write() as session:
        admins = people.lock_active_admins(session)
        staff = load_staff(session, name, lock=True)
        if (change.is_disabled or change.is_admin is False) and [admin.id for admin in admins] == [
            staff.id
        ]:
            raise ConflictError(
                "This is the last admin: create another one first, or nobody can run the server.",
                code="last_admin",
            )
        fields = []
        if change.is_admin is not None and change.is_admin != staff.is_admin:
            staff.is_admin = change.is_admin
            fields.append("is_admin")
        if change.is_disabled is not None and change.is_disabled != (staff.disabled_at is not None):
            staff.disabled_at = now if change.is_disabled else None
            fields.append("is_disabled")
        is_replaced = hashed is not None and staff.password_hash is not None
        if hashed is not None:
            staff.password_hash = hashed
            fields.append("password")
        if change.ends_totp and staff.has_totp:
            staff.totp_secret = None
            fields.append("totp")
        ended = (
            end_access(session, staff, now) if change.is_disabled or is_replaced else EndedAccess()
        )
        if fields:
            note(
                session,
                caller,
                "staff.change",
                subject=staff.name,
                fields=fields,
                sessions_ended=ended.sessions,
                tokens_ended=len(ended.tokens),
            )
        return ChangedStaff(staff, ended)


def load_staff(session: Session, name: str, *, lock: bool = False) -> Staff:
    """Return the staff member with a name, locked until commit if `lock` is set.

    Raises NotFoundError.
    """
    staff = people.find_staff(session, normal_name(name), lock=lock)
    if staff is None:
        raise NotFoundError("There is no such staff member.")
    return staff


def normal_name(name: str) -> str:
    """Normalise a name, so that different Unicode forms of it are the same name."""
    return unicodedata.normalize("NFC", name).strip()


def _new_name(name: str) -> str:
    """Normalise and check the name of a new staff member.

    Raises InvalidInputError (`staff_name_invalid`).

    Names appear in URLs and in the log, so e-mail addresses and characters that URLs escape are
    refused.
    """
    cleaned = normal_name(name)
    fits = 0 < len(cleaned) <= NAME_LENGTH and cleaned[:1].isalnum()
    if not fits or not all(character.isalnum() or character in " ._'-" for character in cleaned):
        raise InvalidInputError(
            f"A name has 1 to {NAME_LENGTH} letters and digits; spaces, . _ ' and - are allowed after the first.",
            code="staff_name_invalid",
        )
    return cleaned


def _add(
    session: Session, caller: Caller | None, name: str, *, is_admin: bool, password_hash: str | None
) -> Staff:
    cleaned = _new_name(name)
    staff = Staff(
        id=uuid.uuid4(),
        name=cleaned,
        is_admin=is_admin,
        password_hash=password_hash,
        created_at=datetime.now(UTC),
    )
    session.add(staff)
    session.flush()
    note(session, caller, "staff.create", subject=cleaned, is_admin=is_admin)
    return staff


def _exists_error(name: str) -> ConflictError:
    return ConflictError(
        f"There is already a staff member named {name!r}: use another name.", code="staff_exists"
    )


def list_members(
    database: Database, study_code: str, *, cursor: str | None, limit: int
) -> Page[MemberOut]:
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
) -> MemberOut:
    """Give a staff member a role in a study or change it.

    Raises NotFoundError, ConflictError (`last_owner`).
    """
    with database.write() as session:
        study, staff, member = _find_member(session, study_code, name)
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
    """Remove a member from a study, which their tokens no longer reach.

    Raises NotFoundError, ConflictError.
    """
    with database.write() as session:
        study, staff, member = _find_member(session, study_code, name)
        if member is None:
            raise NotFoundError("There is no such member of the study.")
        _require_other_owner(session, study.id, staff.id, member.role)
        session.delete(member)
        note(session, caller, "member.remove", study_id=study.id, subject=staff.name)


def _find_member(
    session: Session, study_code: str, name: str
) -> tuple[Study, Staff, StudyMember | None]:
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


def _membership(member: StudyMember, staff: Staff) -> MemberOut:
    return MemberOut(
        name=staff.name,
        role=member.role,
        is_disabled=staff.disabled_at is not None,
        since=member.created_at,
    )
