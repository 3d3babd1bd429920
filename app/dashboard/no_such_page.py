"""An address below a study's that no page has: refused as every page of the study is, then told as what it is.

The last of the dashboard's routes. Whoever may not enter the study hears of the study, as on all of its pages.
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
    """Without the slash at its end where there is one; else it is not found."""
    if not rest.endswith("/") and rest:
        raise NotFoundError("There is no such page.")
    parts = [part for part in rest.split("/") if part]
    target, query = study_address(study, *parts), page.request.url.query
    return RedirectResponse(f"{target}?{query}" if query else target, status_code=307)
