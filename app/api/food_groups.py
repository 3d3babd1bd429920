"""/v1/food-groups: the groups that foods can be narrowed down to."""

from fastapi import APIRouter

from app.api.deps import CurrentCaller, State
from app.api.flat_list import ListRoute
from app.api.problems import problem_responses
from app.api.schemas.foods import FoodGroupList, FoodGroupOut
from app.services.search_foods import food_groups

router = APIRouter(prefix="/v1/food-groups", tags=["foods"], route_class=ListRoute)


@router.get("", responses=problem_responses(401))
def get_food_groups(state: State, _: CurrentCaller) -> FoodGroupList:
    """The groups of the foods in force, by name."""
    return FoodGroupList(
        items=[FoodGroupOut.model_validate(group, from_attributes=True) for group in food_groups(state.database)]
    )
