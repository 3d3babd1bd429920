"""/v1/foods and /v1/food-groups: the food tables in force."""

from dataclasses import asdict, fields
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from app.foods.foods import FoodView, read_food
from app.foods.models import Component
from app.foods.recipes import RecipeView
from app.foods.schemas import FoodGroupList, FoodList, FoodOut
from app.foods.search.search_foods import food_groups, search_foods
from app.http.flat_list import ListRoute
from app.http.paging import Limit
from app.http.problems import problem_responses
from app.http.text_schemas import stored_word
from app.nutrition.density import DensityChoice
from app.nutrition.foods import FOOD_STATES
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentCaller, State

router = APIRouter(prefix="/v1", tags=["foods"], route_class=ListRoute)

FoodKey = Annotated[
    str, Path(max_length=100, description="The food's key, or its number in a published table.")
]


@router.get("/foods", responses=problem_responses(401, 422))
def get_foods(
    state: State,
    _: CurrentCaller,
    q: Annotated[
        str | None,
        Query(
            max_length=100,
            description="Words of a name or alias, begun or whole; or a published table's number.",
        ),
    ] = None,
    group: Annotated[
        str | None,
        Query(
            max_length=100,
            description="A food group's exact name, case aside: GET /v1/food-groups.",
        ),
    ] = None,
    limit: Limit = 100,
) -> FoodList:
    """Foods, best match first; without `q`, in the tables' order. An unknown group has no foods."""
    return FoodList(items=search_foods(state.database, q, group=group, limit=limit))


@router.get("/foods/{key}", responses=problem_responses(401, 404, 422))
def get_food(state: State, caller: CurrentCaller, key: FoodKey, response: Response) -> FoodOut:
    """One food: nutrients per 100 g edible portion, refuse by part, the density chosen and what it was chosen over.

    A participant's device sees the density that its study uses. `ETag` names the food's version, for `If-Match`.
    """
    study_id = caller.study_id if isinstance(caller, DeviceCaller) else None
    view = read_food(state.database, key, study_id)
    response.headers["ETag"] = etag_of(view)
    return render_food(view)


@router.get("/food-groups", responses=problem_responses(401))
def get_food_groups(state: State, _: CurrentCaller) -> FoodGroupList:
    """The groups of the foods in force, by name."""
    return FoodGroupList(items=food_groups(state.database))


def etag_of(view: FoodView) -> str:
    """Return the ETag of this version of the food; versions never change."""
    return f'"{view.food.id}"'


def render_food(view: FoodView) -> FoodOut:
    """Return a food as the API shows it."""
    value = {field.name: getattr(view.value, field.name) for field in fields(view.value)}
    return FoodOut.model_validate(
        value
        | {
            "group": view.value.food_group,
            "version": view.food.version,
            "edible_share": view.edible_share,
            "release": view.release,
            "densities": view.own_densities,
            "density": _density_choice(view.density),
            "nutrients": [
                _component(row.component) | {"per_100_g": row.per_100_g} for row in view.nutrients
            ],
            "recipe": _recipe(view.recipe),
        },
        from_attributes=True,
    )


def _component(component: Component) -> dict[str, object]:
    return {
        name: getattr(component, name)
        for name in ("number", "tagname", "name", "unit", "expression")
    }


def _recipe(recipe: RecipeView | None) -> dict[str, object] | None:
    if recipe is None:
        return None
    ingredients = [
        {
            name: getattr(part, name)
            for name in ("mass_g", "retention", "retention_source", "is_current")
        }
        | {name: getattr(part.food, name) for name in ("key", "name", "version")}
        | {"state": stored_word(part.food.state, FOOD_STATES)}
        for part in recipe.ingredients
    ]
    unknown = [
        _component(component) | {"coverage": coverage} for component, coverage in recipe.unknown
    ]
    return {"yield_factor": recipe.recipe_yield, "ingredients": ingredients, "unknown": unknown}


def _density_choice(choice: DensityChoice | None) -> dict[str, object] | None:
    if choice is None:
        return None
    alternatives = [
        asdict(rejected.density) | {"reason": rejected.reason} for rejected in choice.alternatives
    ]
    return {"chosen": choice.chosen, "reason": choice.reason, "alternatives": alternatives}
