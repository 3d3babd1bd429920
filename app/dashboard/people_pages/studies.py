"""The first page: the studies in which the caller has a role."""

from fastapi import APIRouter
from starlette.responses import HTMLResponse

from app.dashboard.page import CurrentPage
from app.http.paging import Cursor
from app.people.access.caller import role_in
from app.people.access.page_rules import PREFIX
from app.people.studies import list_studies

router = APIRouter(include_in_schema=False)
STUDIES_A_PAGE = 100


@router.get(PREFIX)
def get_studies(page: CurrentPage, cursor: Cursor = None) -> HTMLResponse:
    """The studies, with links to their pages."""
    studies = list_studies(page.state.database, page.caller, cursor=cursor, limit=STUDIES_A_PAGE)
    rows = [(study, role_in(page.caller, study.id)) for study in studies.rows]
    return page.render("studies.html", rows=rows, next=studies.cursor)
