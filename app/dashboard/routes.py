"""The dashboard's routes. Permissions are in app/people/access/page_rules.py."""

from fastapi import APIRouter
from starlette.responses import RedirectResponse, Response

from app.core.errors import NotFoundError
from app.dashboard.data_pages import exports, overview, reference, releases, remeasurements
from app.dashboard.food_pages import food_forms, foods, study_densities, study_vessels, teach_food
from app.dashboard.meal_pages import blind, item_actions, meal, meal_list, review
from app.dashboard.page import CurrentPage
from app.dashboard.people_pages import (
    account,
    audit,
    devices,
    institution,
    participant,
    participants,
    staff,
    studies,
    webhooks,
)
from app.people.access.page_rules import ELSEWHERE, study_address

router = APIRouter(include_in_schema=False)
for page in (
    account,
    institution,
    studies,
    overview,
    item_actions,
    review,
    blind,
    meal_list,
    meal,
    participants,
    participant,
    reference,
    exports,
    releases,
    remeasurements,
    devices,
    webhooks,
    staff,
    foods,
    food_forms,
    study_densities,
    study_vessels,
    teach_food,
    audit,
):
    router.include_router(page.router)


@router.get(ELSEWHERE)  # the last one: it matches every remaining address
def get_no_such_page(page: CurrentPage, study: str, rest: str) -> Response:
    """Redirect to the address without its trailing slash; without one raise NotFoundError.

    Without access to the study the answer is the same as on its pages.
    """
    if not rest.endswith("/") and rest:
        raise NotFoundError("There is no such page.")
    parts = [part for part in rest.split("/") if part]
    target, query = study_address(study, *parts), page.request.url.query
    return RedirectResponse(f"{target}?{query}" if query else target, status_code=307)
