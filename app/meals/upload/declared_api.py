"""/v1/declared-meals: a participant enters a meal without photographs."""

from datetime import UTC, datetime
from typing import Any

from fastapi import APIRouter
from fastapi.responses import JSONResponse

from app.http.problems import problem_responses
from app.meals.stored.meal_time import meal_time
from app.meals.upload.declare_meal import DeclaredMeal, DeclareMeal
from app.meals.upload.schemas import DeclaredMealIn
from app.people.access.deps import CurrentDevice, State
from app.records.meal_schemas import MealOut
from app.records.read_meal import read_meal
from app.records.review.api import tagged_meal

router = APIRouter(prefix="/v1/declared-meals", tags=["review"])

DECLARE_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": MealOut, "description": "The same as before: nothing was added."},
    201: {"model": MealOut, "description": "Kept and confirmed; Location names the meal."},
    **problem_responses(400, 401, 403, 409, 410, 413, 422, 503),
}


@router.post("", status_code=201, response_model=MealOut, responses=DECLARE_RESPONSES)
def post_declared_meal(body: DeclaredMealIn, state: State, caller: CurrentDevice) -> JSONResponse:
    """Enter a meal without photographs: foods and amounts. From then on it is a meal like all others."""
    declared = DeclaredMeal(
        client_id=body.id,
        time=meal_time(body.captured_at, body.time_zone, datetime.now(UTC)),
        items=tuple(body.items),
        location=body.location.model_dump(exclude_none=True) if body.location else None,
        app_version=body.app_version,
    )
    is_new = state.part(DeclareMeal).declare(caller, declared)
    answer = tagged_meal(read_meal(state.database, caller, body.id), 201 if is_new else 200)
    answer.headers["Location"] = f"/v1/meals/{body.id}"
    return answer
