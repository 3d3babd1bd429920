"""/v1/meals/{meal_id}/cancel and /retry: cancel an estimate, or have a failed meal estimated again."""

from typing import Any

from fastapi import APIRouter
from fastapi.responses import JSONResponse

from app.http.parameters import MealId, OfWhichParticipant
from app.http.problems import problem_responses
from app.jobs.queue import JobQueue
from app.meals.upload.api import meal_response
from app.meals.upload.cancel_or_retry import cancel_meal, retry_meal
from app.people.access.deps import CurrentCaller, CurrentStaff, State
from app.records.meal_schemas import MealOut

router = APIRouter(prefix="/v1/meals", tags=["meals"])

PROBLEMS = problem_responses(401, 403, 404, 409, 410, 422)
RETRY_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": MealOut, "description": "It waits for its estimate already: nothing changed."},
    202: {"model": MealOut, "description": "Queued again; Location names the meal."},
    **PROBLEMS,
}


@router.post("/{meal_id}/cancel", response_model=MealOut, responses=PROBLEMS)
def post_cancel(
    meal_id: MealId, state: State, caller: CurrentCaller, participant: OfWhichParticipant = None
) -> JSONResponse:
    """Cancel the estimate of a meal, or of its after-meal pair, that is not made yet.

    Its status becomes `failed` with the code `cancelled`; its photographs are kept. Repeated, it gives the same answer.
    """
    return meal_response(cancel_meal(state.database, caller, meal_id, participant), 200)


@router.post("/{meal_id}/retry", status_code=202, response_model=MealOut, responses=RETRY_RESPONSES)
def post_retry(
    meal_id: MealId, state: State, caller: CurrentStaff, participant: OfWhichParticipant = None
) -> JSONResponse:
    """Have a meal, or its after-meal pair, that failed estimated again. Calls at the same time queue it once."""
    view, is_new = retry_meal(state.database, state.part(JobQueue), caller, meal_id, participant)
    return meal_response(view, 202 if is_new else 200)
