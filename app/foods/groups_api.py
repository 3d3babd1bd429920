"""/v1/food-groups: the groups that foods can be narrowed down to."""

from fastapi import APIRouter

from app.foods.schemas import FoodGroupList, FoodGroupOut
from app.foods.search.search_foods import food_groups
from app.http.flat_list import ListRoute
from app.http.problems import problem_responses
from app.people.access.deps import CurrentCaller, State

router = APIRouter(prefix="/v1/food-groups", tags=["foods"], route_class=ListRoute)


@router.get("", responses=problem_responses(401))
def get_food_groups(state: State, _: CurrentCaller) -> FoodGroupList:
    """The groups of the foods in force, by name."""
    return FoodGroupList(
        items=[FoodGroupOut.model_validate(group, from_attributes=True) for group in food_groups(state.database)]
    )
