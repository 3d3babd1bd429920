"""Review events sent by a meal's page, by the same models and use case as the API's.

A script that accepts JSON gets the API's meal with its ETag, or a problem document. htmx gets the
meal's section rendered again; a browser without scripts is redirected to the page.
"""

import uuid
from typing import Annotated

from fastapi import APIRouter, Form, Query
from starlette.responses import HTMLResponse, Response

from app.core.errors import InvalidInputError, PreconditionFailedError
from app.dashboard.meal_pages.event_form import EventForm, event_of
from app.dashboard.meal_pages.meal import Refused, meal_address, render_meal_page
from app.dashboard.meal_pages.meal_timeline import TITLES
from app.dashboard.page import CurrentPage, Page
from app.foods.search.search_foods import search_foods
from app.meals.stored.item_state import IMPLAUSIBLE_AMOUNT
from app.people.access.page_rules import MEAL, PREFIX
from app.records.render import tagged_meal
from app.records.review.meal_events import MealEvents

router = APIRouter(include_in_schema=False)

FOODS_OFFERED = 12


@router.post(MEAL + "/events")
def post_event(
    page: CurrentPage, participant: str, meal_id: uuid.UUID, form: Annotated[EventForm, Form()]
) -> Response:
    """Append one event to the meal if it is unchanged since it was shown: confirm, correct, reject, ask, undo."""
    event = event_of(form)
    try:
        view, is_new = page.state.part(MealEvents).append(
            page.study_caller,
            meal_id,
            event,
            expected=frozenset({form.version}),
            participant_code=participant,
        )
    except (PreconditionFailedError, InvalidInputError) as error:
        if wants_json(page) or error.code not in (PreconditionFailedError.code, IMPLAUSIBLE_AMOUNT):
            raise
        return render_meal_page(
            page, participant, meal_id, is_section=page.is_fragment, refused=Refused(form, error)
        )
    if wants_json(page):
        return tagged_meal(view, 201 if is_new else 200)
    saved = f"{TITLES[event.kind]}: saved."
    if page.is_fragment:
        return render_meal_page(page, participant, meal_id, is_section=True, saved=saved)
    return page.redirect(meal_address(page, participant, meal_id), saved)


@router.get(PREFIX + "/studies/{study}/foods")
def get_food_options(
    page: CurrentPage,
    q: Annotated[str, Query(max_length=100)] = "",
    list_id: Annotated[str, Query(alias="list", max_length=80)] = "foods",
) -> HTMLResponse:
    """Foods that match the text, as options of the list box `list`; their ids begin with its id."""
    foods = search_foods(page.database, q, limit=FOODS_OFFERED) if q.strip() else []
    return page.render("food_options.html", foods=foods, words=q, list_id=list_id)


def wants_json(page: Page) -> bool:
    """Whether a script sent the request, not a browser's form."""
    accept = page.request.headers.get("accept", "")
    return "application/json" in accept and "text/html" not in accept
