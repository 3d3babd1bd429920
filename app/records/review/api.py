"""/v1/meals/{meal_id}/events: events of the participant and reviewers about a meal, and their history."""

from typing import Any

from fastapi import APIRouter, Request

from app.http.conditions import IfMatch, expected_versions
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import MealId, OfWhichParticipant
from app.http.problems import problem_responses
from app.people.access.deps import CurrentCaller, State
from app.records.meal_schemas import MealOut
from app.records.read_meal import MealView
from app.records.render import render_meal
from app.records.review.meal_events import MealEvents
from app.records.review.meal_history import HistoryRow, read_history
from app.records.review.schemas import EventIn, EventList, EventOut

router = APIRouter(prefix="/v1/meals", tags=["review"])

EVENT_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": MealOut, "description": "The same event as before: nothing was changed."},
    201: {"model": MealOut, "description": "The meal as it stands with the event."},
    **problem_responses(400, 401, 403, 404, 409, 410, 412, 413, 422, 428),
}


@router.post(
    "/{meal_id}/events", status_code=201, response_model=MealOut, responses=EVENT_RESPONSES
)
def post_event(
    meal_id: MealId,
    body: EventIn,
    state: State,
    caller: CurrentCaller,
    if_match: IfMatch = None,
    participant: OfWhichParticipant = None,
) -> ModelResponse:
    """Confirm, correct, reject, add, split, merge or ask. `If-Match` names the version of the meal that was seen."""
    view, is_new = state.part(MealEvents).append(
        caller, meal_id, body, expected=expected_versions(if_match), participant_code=participant
    )
    return tagged_meal(view, 201 if is_new else 200)


@router.get("/{meal_id}/events", responses=problem_responses(401, 403, 404, 409, 422))
def get_events(
    request: Request,
    meal_id: MealId,
    state: State,
    caller: CurrentCaller,
    limit: Limit = 100,
    cursor: Cursor = None,
    participant: OfWhichParticipant = None,
) -> EventList:
    """All that was said of the meal, the oldest first, what was undone as well."""
    page = read_history(state.database, caller, meal_id, participant, cursor=cursor, limit=limit)
    return EventList(items=[_event(row) for row in page.rows], next=next_page(request, page.cursor))


def tagged_meal(view: MealView, status: int) -> ModelResponse:
    """Return the meal as the answer to a change, with its ETag."""
    headers = {"ETag": f'"{view.meal.version}"'}
    return ModelResponse(render_meal(view), status_code=status, headers=headers)


def _event(row: HistoryRow) -> EventOut:
    event = row.event
    return EventOut(
        id=event.id,
        sequence=event.sequence,
        kind=event.kind,
        layer=event.layer,
        author=row.author,
        item=event.item_id,
        old=event.old,
        new=event.new,
        undone=row.is_undone,
        created_at=event.created_at,
    )
