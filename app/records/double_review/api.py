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
from app.records.double_review import known_items
from app.records.double_review.queries import MadeDecision
from app.records.double_review.schemas import DecisionList, DecisionOut, KnownItemIn
from app.records.double_review.study_agreement import decided_by_two

SAME_COLUMNS = ("is_final", "mass_g", "energy_kcal", "decided_at", "settled_at")
MEAL_COLUMNS = (("meal", "client_id"), ("local_date", "local_date"))

router = APIRouter(prefix="/v1/studies/{study}", tags=["review"], route_class=ListRoute)


@router.get("/decisions", responses=problem_responses(401, 403, 404, 422))
def get_decisions(study: StudyCode, state: State, _: CurrentStaff) -> DecisionList:
    """All decisions about items that two reviewers have decided without seeing each other, and a third's."""
    with state.database.read() as session:
        made = decided_by_two(session, load_study(session, study).id)
    return DecisionList(items=[render_decision(each) for item in made for each in item])


def render_decision(made: MadeDecision) -> DecisionOut:
    """Return a decision about a meal's item as the API shows it."""
    columns = {name: getattr(made.decision, name) for name in SAME_COLUMNS}
    names = {"reviewer": made.reviewer, "participant": made.participant}
    item = {"item": made.decision.item_id, "food": made.decision.food_key}
    meal = {name: getattr(made.meal, of_meal) for name, of_meal in MEAL_COLUMNS}
    return DecisionOut.model_validate(columns | names | item | meal)


@router.post(
    "/known-items",
    status_code=204,
    response_class=Response,
    responses=problem_responses(401, 403, 404, 409, 413, 422, 503),
)
def post_known_item(
    study: StudyCode, body: KnownItemIn, state: State, caller: CurrentStaff
) -> None:
    """Keep an item with a known answer, to be mixed among those that reviewers decide."""
    known_items.add_known_item(state, caller, read_study(state.database, study), body)


@router.delete(
    "/known-items/{item}",
    status_code=204,
    response_class=Response,
    responses=problem_responses(401, 403, 404, 422),
)
def delete_known_item(
    study: StudyCode,
    item: Annotated[uuid.UUID, Path(description="The item's id.")],
    state: State,
    caller: CurrentStaff,
) -> None:
    """Delete an item with a known answer, and what reviewers decided about it."""
    known_items.remove_known_item(state, caller, read_study(state.database, study), item)
