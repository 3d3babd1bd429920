"""/v1/studies/{study}/decisions, .../known-items: what two reviewers decided, items with a known answer.

Items are decided on the dashboard's page alone.
"""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path, Response

from app.http.flat_list import ListRoute
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.people.access.deps import CurrentStaff, State
from app.people.studies import load_study, read_study
from app.records.double_review.known_items import put_known_item
from app.records.double_review.queries import decided_by_two
from app.records.double_review.schemas import DecisionList, KnownItemIn

router = APIRouter(
    prefix="/v1/studies/{study}",
    tags=["review"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 404, 422),
)


@router.get("/decisions")
def get_decisions(study: StudyCode, state: State, _: CurrentStaff) -> DecisionList:
    """All decisions about items that two reviewers have decided without seeing each other, and a third's."""
    with state.database.read() as session:
        items = decided_by_two(session, load_study(session, study).id)
    return DecisionList(items=[decision for item in items for decision in item])


@router.put(
    "/known-items/{item}",
    status_code=204,
    response_class=Response,
    responses=problem_responses(413, 503),
)
def put_item(
    study: StudyCode,
    item: Annotated[uuid.UUID, Path(description="Made by the client.")],
    body: KnownItemIn,
    state: State,
    caller: CurrentStaff,
) -> None:
    """Keep an item with a known answer, to be mixed among those that reviewers decide, or replace it."""
    put_known_item(state, caller, read_study(state.database, study), item, body)
