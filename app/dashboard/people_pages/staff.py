"""Staff accounts, for admins, and the staff's roles in a study, for its owners."""

from fastapi import APIRouter
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, NotFoundError, UnavailableError
from app.dashboard.forms import EMPTY_FORM, Fields, FormState, form_values, read_form, refused
from app.dashboard.page import CurrentPage, Page
from app.http.paging import Cursor
from app.people.access import staff
from app.people.access.page_rules import PREFIX, study_address
from app.people.access.passwords import Passwords
from app.people.access.staff_schemas import MemberIn, StaffIn, StaffPatch

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/staff"
STAFF_A_PAGE = 200

MEMBERS = f"{PREFIX}/studies/{{study}}/members"
MEMBERS_A_PAGE = 200


@router.get(PATH)
def get_staff(page: CurrentPage, cursor: Cursor = None) -> Response:
    """All staff, by name."""
    return _staff(page, cursor)


@router.post(PATH)
def post_staff(page: CurrentPage, fields: Fields) -> Response:
    """Create a staff member, with a first password that they change on their account's page."""
    values = form_values(fields)
    try:
        body = read_form(StaffIn, {**values, "is_admin": "is_admin" in values})
        staff.create_staff(
            page.database,
            page.state.part(Passwords),
            body.name,
            is_admin=body.is_admin,
            password=body.password.get_secret_value() if body.password is not None else None,
            caller=page.caller,
        )
    except (ConflictError, InvalidInputError, UnavailableError) as error:
        values.pop("password", None)
        return _staff(page, form=refused(error, values, "name"))
    return page.redirect(
        PATH, f"{body.name} was added. A study's owner, or you, gives them a role under Members."
    )


@router.post(f"{PATH}/change")
def post_change(page: CurrentPage, fields: Fields) -> Response:
    """Change whether a staff member is an admin or disabled, or their password."""
    values = form_values(fields)
    name = values.pop("name", "")
    body = read_form(StaffPatch, values)
    password = body.password.get_secret_value() if body.password is not None else None
    change = staff.StaffChange(body.is_admin, body.is_disabled, password, ends_totp=body.ends_totp)
    changed = staff.change_staff(
        page.database, page.state.part(Passwords), name, change, page.caller
    )
    return page.redirect(PATH, f"{name} was changed.{changed.ended.sentence}")


def _staff(page: Page, cursor: str | None = None, form: FormState = EMPTY_FORM) -> Response:
    members = staff.list_staff(page.database, cursor=cursor, limit=STAFF_A_PAGE)
    return page.render("staff.html", form=form, rows=members.rows, next=members.cursor)


@router.get(MEMBERS)
def get_members(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The members, by name."""
    return _members(page, study, cursor)


@router.post(MEMBERS)
def post_member(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Give a staff member a role in the study, or change it."""
    values = form_values(fields)
    name = values.get("name", "")
    try:
        body = read_form(MemberIn, {"role": values.get("role", "")})
        staff.set_member(page.database, page.caller, study, name, body.role)
    except (NotFoundError, ConflictError, InvalidInputError) as error:
        return _members(page, study, form=refused(error, values, "name"))
    return page.redirect(study_address(study, "members"), f"{name} now has the role {body.role}.")


@router.post(f"{MEMBERS}/removal")
def post_removal(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Remove a staff member from the study."""
    name = form_values(fields).get("name", "")
    staff.remove_member(page.database, page.caller, study, name)
    return page.redirect(
        study_address(study, "members"), f"{name} was removed from the study's staff."
    )


def _members(
    page: Page, study: str, cursor: str | None = None, form: FormState = EMPTY_FORM
) -> Response:
    members = staff.list_members(page.database, study, cursor=cursor, limit=MEMBERS_A_PAGE)
    return page.render("members.html", form=form, rows=members.rows, next=members.cursor)
