"""/v1/meals/{meal_id}/events, /v1/studies/{study}/review-queue and /v1/me/questions.

Events of the participant and reviewers about a meal, and their history; what reviewers look at
first; what they want to know of the participant.
"""

from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import APIRouter, Query, Request

from app.http.flat_list import ListRoute
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit
from app.http.parameters import (
    IfMatch,
    MealId,
    OfParticipant,
    OfWhichParticipant,
    StudyCode,
    expected_versions,
)
from app.http.problems import Responses, problem_responses
from app.meals.stored.models import MealOrigin
from app.meals.stored.record_models import EffectiveRecord
from app.people.access.deps import CurrentCaller, CurrentDevice, CurrentStaff, State
from app.people.studies import read_study
from app.records.meal_schemas import MealOut
from app.records.render import food_ref, render_candidates, shared_columns, tagged_meal
from app.records.review.meal_events import MealEvents
from app.records.review.meal_history import HistoryRow, read_history
from app.records.review.queries import QueueFilter
from app.records.review.queue_schemas import QuestionList, QuestionOut, QueuedItemOut, ReviewQueue
from app.records.review.review_items import QueuedItem, open_questions, read_queue
from app.records.review.schemas import EventIn, EventList, EventOut

router = APIRouter(tags=["review"], responses=problem_responses(401, 403))

EVENT_RESPONSES: Responses = {
    200: {"model": MealOut, "description": "The same event as before: nothing was changed."},
    201: {"model": MealOut, "description": "The meal as it stands with the event."},
    **problem_responses(400, 404, 409, 410, 412, 413, 422, 428),
}


@router.post(
    "/v1/meals/{meal_id}/events", status_code=201, response_model=MealOut, responses=EVENT_RESPONSES
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


@router.get("/v1/meals/{meal_id}/events", responses=problem_responses(404, 409, 422))
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
    return EventList.of(request, page, _event)


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


@router.get("/v1/me/questions")
def get_questions(state: State, caller: CurrentDevice) -> QuestionList:
    """Questions that wait for an answer: an event of kind `answer` of the meal."""
    return QuestionList(
        items=[
            QuestionOut(
                id=event.id,
                meal=meal.client_id,
                item=event.item_id,
                text=event.new["text"],
                asked_at=event.created_at,
                captured_at=meal.captured_at,
                local_date=meal.local_date,
                etag=f'"{meal.version}"',
            )
            for event, meal in open_questions(state.database, caller)
        ]
    )


lists = APIRouter(route_class=ListRoute)

QUEUED_COLUMNS = shared_columns(EffectiveRecord, QueuedItemOut)


@lists.get("/v1/studies/{study}/review-queue", responses=problem_responses(401, 403, 404, 422))
def get_review_queue(
    request: Request,
    study: StudyCode,
    state: State,
    _: CurrentStaff,
    status: Annotated[
        Literal["proposed", "needs_review", "confirmed", "corrected"] | None,
        Query(description="Only items of this status."),
    ] = None,
    food: Annotated[str | None, Query(max_length=100, description="A food's key.")] = None,
    min_doubt: Annotated[
        float | None, Query(ge=0, le=1, description="Only items of at least this doubt.")
    ] = None,
    provisional: Annotated[
        bool | None, Query(description="Whether an after-meal pair may still come.")
    ] = None,
    participant: OfParticipant = None,
    origin: Annotated[
        MealOrigin | None, Query(description="Only items of meals photographed, or declared.")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=200, description="Items of a page, at most.")] = 50,
    cursor: Cursor = None,
) -> ReviewQueue:
    """Items that need a look, by doubt, the greatest first: not settled by a reviewer, nor by a complete text entry."""
    chosen = QueueFilter(
        study_id=read_study(state.database, study).id,
        status=status,
        food_key=food,
        min_doubt=min_doubt,
        provisional=provisional,
        participant_code=participant,
        origin=origin,
    )
    page = read_queue(state.database, chosen, cursor=cursor, limit=limit)
    return ReviewQueue.of(request, page, _queued_item)


def _queued_item(queued: QueuedItem) -> QueuedItemOut:
    row, record = queued.row, queued.row.record
    path, whose = f"/v1/meals/{row.meal.client_id}", f"?participant={quote(row.participant_code)}"
    return QueuedItemOut(
        **{name: getattr(record, name) for name in QUEUED_COLUMNS},
        item=record.item_id,
        meal=row.meal.client_id,
        participant=row.participant_code,
        food=food_ref(row.food),
        candidates=render_candidates(queued.candidates),
        none_of_these=queued.candidates.none_probability,
        volume_interval_ml=record.interval("volume", "ml"),
        mass_interval_g=record.interval("mass", "g"),
        consumed_interval_g=record.interval("consumed", "g"),
        etag=f'"{row.meal.version}"',
        meal_href=f"{path}{whose}",
        photograph_href=f"{path}/images/left{whose}" if row.meal.origin == "photographed" else None,
    )


router.include_router(lists)
