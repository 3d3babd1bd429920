"""Who works in a study, and as what; an owner decides."""

from fastapi import APIRouter
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.dashboard.addresses import study_address
from app.dashboard.forms import Fields, checked, typed
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
    """The members by name."""
    return _members(page, study, cursor, {}, {})


@router.post(PATH)
def post_member(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Give somebody a role, or another one."""
    values = typed(fields)
    body, wrong = checked(MemberIn, {"role": values.get("role", "")})
    if body is None:
        return _members(page, study, None, values, wrong, status=422)
    try:
        name = values.get("name", "")
        study_members.set_member(page.state.database, page.caller, study, name, body.role)
    except (NotFoundError, ConflictError, InvalidInputError) as error:
        return _members(page, study, None, values, {"name": error.message}, status=error.status)
    return page.go(study_address(study, "members"), f"{values['name']} is {body.role} now.")


@router.post(f"{PATH}/removal")
def post_removal(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Take somebody out of the study."""
    name = typed(fields).get("name", "")
    study_members.remove_member(page.state.database, page.caller, study, name)
    return page.go(study_address(study, "members"), f"{name} has left the study's staff.")


def _members(
    page: Page, study: str, cursor: str | None, values: dict[str, str], wrong: dict[str, str], status: int = 200
) -> Response:
    found = study_members.list_members(page.state.database, study, cursor=cursor, limit=MEMBERS_A_PAGE)
    return page.render("members.html", status=status, rows=found.rows, next=found.cursor, values=values, wrong=wrong)
