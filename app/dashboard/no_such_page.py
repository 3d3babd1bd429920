"""Unknown addresses below a study: access to the study is checked first, then the answer is 404.

This must be the last of the dashboard's routes. Without access to the study the answer is the same as on its pages.
"""

from fastapi import APIRouter
from starlette.responses import RedirectResponse, Response

from app.core.errors import NotFoundError
from app.dashboard.addresses import study_address
from app.dashboard.page import CurrentPage
from app.people.access.page_rules import ELSEWHERE

router = APIRouter(include_in_schema=False)


@router.get(ELSEWHERE)
def get_no_such_page(page: CurrentPage, study: str, rest: str) -> Response:
    """Redirect to the address without its trailing slash; without one raise NotFoundError."""
    if not rest.endswith("/") and rest:
        raise NotFoundError("There is no such page.")
    parts = [part for part in rest.split("/") if part]
    target, query = study_address(study, *parts), page.request.url.query
    return RedirectResponse(f"{target}?{query}" if query else target, status_code=307)
