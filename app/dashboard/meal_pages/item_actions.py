"""What reviewers say of a meal by a page: events of the meal's history, by the same models and service as the API's.

A script that asks for JSON gets the meal as the API gives it, with its ETag; problems are problem documents. htmx gets
the meal's section anew, a browser without scripts is led back to the page.
"""

import uuid
from typing import Annotated

from fastapi import APIRouter, Form, Query
from starlette.responses import HTMLResponse, Response

from app.core.errors import PreconditionFailedError
from app.dashboard.meal_pages.event_form import EventForm, event_of
from app.dashboard.meal_pages.meal import conflict_of, context_of, meal_address
from app.dashboard.meal_pages.meal_timeline import TITLES
from app.dashboard.one_study import in_study
from app.dashboard.page import CurrentPage, Page
from app.foods.search.search_foods import search_foods
from app.people.access.page_rules import MEAL, PREFIX
from app.records.review.api import new_event, tagged_meal
from app.records.review.meal_events import MealEvents

router = APIRouter(include_in_schema=False)

FOODS_OFFERED = 12


@router.post(MEAL + "/events")
def post_event(page: CurrentPage, participant: str, meal_id: uuid.UUID, form: Annotated[EventForm, Form()]) -> Response:
    """Confirm, correct, reject, ask, undo: one word about the meal as it was shown."""
    event = new_event(event_of(form))
    try:
        view, is_new = page.state.part(MealEvents).append(
            in_study(page), meal_id, event, expected=frozenset({form.version}), participant_code=participant
        )
    except PreconditionFailedError as error:
        if wants_json(page):
            raise
        return _conflict(page, participant, meal_id, form, error.status)
    if wants_json(page):
        return tagged_meal(view, 201 if is_new else 200)
    said = f"{TITLES[event.kind]}: noted."
    if page.is_fragment:
        context = context_of(page, participant, meal_id)
        return page.render("meal_body.html", **context | {"said": said})
    return page.go(meal_address(page, participant, meal_id), told=said)


@router.get(PREFIX + "/studies/{study}/foods")
def get_food_options(
    page: CurrentPage,
    q: Annotated[str, Query(max_length=100)] = "",
    list_id: Annotated[str, Query(alias="list", max_length=80)] = "foods",
) -> HTMLResponse:
    """Foods that match what is typed, as options of a list box; their ids begin with its id, `list`."""
    found = search_foods(page.state.database, q, limit=FOODS_OFFERED) if q.strip() else []
    return page.render("food_options.html", foods=found, words=q, list_id=list_id)


def _conflict(page: Page, participant: str, meal_id: uuid.UUID, form: EventForm, status: int) -> Response:
    """The meal as it stands by now, with what was said meanwhile and what was not written."""
    context = context_of(page, participant, meal_id)
    context["conflict"] = conflict_of(context["story"], form)
    return page.render("meal_body.html" if page.is_fragment else "meal.html", status=status, **context)


def wants_json(page: Page) -> bool:
    """Whether a script asks, not a person's browser."""
    accept = page.request.headers.get("accept", "")
    return "application/json" in accept and "text/html" not in accept
