"""A study's staff members and their roles, changed by its owners."""

from fastapi import APIRouter
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.dashboard.addresses import study_address
from app.dashboard.forms import Fields, form_values, read_form, wrong_fields
from app.dashboard.page import CurrentPage, Page
from app.http.paging import Cursor
from app.people.access import study_members
from app.people.access.page_rules import PREFIX
from app.people.access.staff_schemas import MemberIn

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/studies/{{study}}/members"
MEMBERS_A_PAGE = 200


@router.get(PATH)
def get_members(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The members, by name."""
    return _members(page, study, cursor, {}, {})


@router.post(PATH)
def post_member(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Give a staff member a role in the study, or change it."""
    values = form_values(fields)
    name = values.get("name", "")
    try:
        body = read_form(MemberIn, {"role": values.get("role", "")})
        study_members.set_member(page.state.database, page.caller, study, name, body.role)
    except (NotFoundError, ConflictError, InvalidInputError) as error:
        return _members(page, study, None, values, wrong_fields(error, "name"), status=error.status)
    return page.redirect(study_address(study, "members"), f"{name} now has the role {body.role}.")


@router.post(f"{PATH}/removal")
def post_removal(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Remove a staff member from the study."""
    name = form_values(fields).get("name", "")
    study_members.remove_member(page.state.database, page.caller, study, name)
    return page.redirect(
        study_address(study, "members"), f"{name} was removed from the study's staff."
    )


def _members(
    page: Page,
    study: str,
    cursor: str | None,
    values: dict[str, str],
    wrong: dict[str, str],
    status: int = 200,
) -> Response:
    members = study_members.list_members(
        page.state.database, study, cursor=cursor, limit=MEMBERS_A_PAGE
    )
    return page.render(
        "members.html",
        status=status,
        rows=members.rows,
        next=members.cursor,
        values=values,
        wrong=wrong,
    )
