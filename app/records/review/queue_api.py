"""/v1/studies/{study}/review-queue: what reviewers look at first."""

from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import APIRouter, Query, Request

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, next_page
from app.http.parameters import OfParticipant, StudyCode
from app.http.problems import problem_responses
from app.meals.stored.models import MealOrigin
from app.meals.stored.record_models import EffectiveRecord
from app.people.access.deps import CurrentStaff, State
from app.people.studies import read_study
from app.records.render import food_ref, render_candidates, shared_columns
from app.records.review.queries import QueueFilter
from app.records.review.queue_schemas import QueuedItemOut, ReviewQueue
from app.records.review.review_queue import QueuedItem, read_queue

router = APIRouter(prefix="/v1/studies", tags=["review"], route_class=ListRoute)

QUEUED_COLUMNS = shared_columns(EffectiveRecord, QueuedItemOut)


@router.get("/{study}/review-queue", responses=problem_responses(401, 403, 404, 422))
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
    return ReviewQueue(
        items=[_item(queued) for queued in page.rows], next=next_page(request, page.cursor)
    )


def _item(queued: QueuedItem) -> QueuedItemOut:
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
