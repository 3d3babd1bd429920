"""/v1/foods: the food tables in force."""

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from app.api.deps import CurrentCaller, State
from app.api.flat_list import ListRoute
from app.api.paging import Limit
from app.api.problems import problem_responses
from app.api.schemas.foods import (
    DensityChoiceOut,
    DensityOut,
    FoodList,
    FoodMatch,
    FoodOut,
    IngredientOut,
    NutrientOut,
    PortionOut,
    RecipeOut,
    RefuseOut,
    RejectedDensityOut,
    UnknownComponentOut,
)
from app.api.stored_words import stored_word
from app.nutrition.density import DensityChoice
from app.nutrition.foods import FOOD_STATES
from app.services.caller import DeviceCaller
from app.services.foods import FoodView, read_food
from app.services.recipes import RecipeView
from app.services.search_foods import search_foods

router = APIRouter(prefix="/v1/foods", tags=["foods"], route_class=ListRoute)

FoodKey = Annotated[str, Path(max_length=100, description="The food's key, or its number in a published table.")]


@router.get("", responses=problem_responses(401, 422))
def get_foods(
    state: State,
    _: CurrentCaller,
    q: Annotated[
        str | None,
        Query(max_length=100, description="Words of a name or alias, begun or whole; or a published table's number."),
    ] = None,
    group: Annotated[
        str | None, Query(max_length=100, description="A food group's exact name, case aside: GET /v1/food-groups.")
    ] = None,
    limit: Limit = 100,
) -> FoodList:
    """Foods, best match first; without `q`, in the tables' order. An unknown group has no foods."""
    found = search_foods(state.database, q, group=group, limit=limit)
    return FoodList(items=[FoodMatch.model_validate(food, from_attributes=True) for food in found])


@router.get("/{key}", responses=problem_responses(401, 404, 422))
def get_food(state: State, caller: CurrentCaller, key: FoodKey, response: Response) -> FoodOut:
    """One food: nutrients per 100 g edible portion, refuse by part, the density chosen and what it was chosen over.

    A participant's device sees the density that its study uses. `ETag` names the food's version, for `If-Match`.
    """
    study_id = caller.study_id if isinstance(caller, DeviceCaller) else None
    view = read_food(state.database, key, study_id)
    response.headers["ETag"] = etag_of(view)
    return render_food(view)


def etag_of(view: FoodView) -> str:
    """The tag of this version of the food: versions never change."""
    return f'"{view.food.id}"'


def render_food(view: FoodView) -> FoodOut:
    """A food as the API shows it."""
    value = view.value
    return FoodOut(
        key=value.key,
        name=value.name,
        aliases=list(value.aliases),
        group=value.food_group,
        form=value.form,
        version=view.food.version,
        state=value.state,
        is_mixed_dish=value.is_mixed_dish,
        refuse=[RefuseOut(**asdict(part)) for part in value.refuse],
        edible_share=view.edible_share,
        probes=list(value.probes),
        source_ids=dict(value.source_ids),
        release=view.release,
        densities=[DensityOut(**asdict(density)) for density in view.own_densities],
        density=_density_choice(view.density),
        nutrients=[
            NutrientOut(
                number=row.component.number,
                tagname=row.component.tagname,
                name=row.component.name,
                unit=row.component.unit,
                expression=row.component.expression,
                per_100_g=row.per_100_g,
            )
            for row in view.nutrients
        ],
        portions=[
            PortionOut(amount=portion.amount, measure=portion.measure, mass_g=portion.mass_g)
            for portion in value.portions
        ],
        recipe=_recipe(view.recipe),
    )


def _recipe(recipe: RecipeView | None) -> RecipeOut | None:
    if recipe is None:
        return None
    return RecipeOut(
        yield_factor=recipe.recipe_yield,
        ingredients=[
            IngredientOut(
                key=part.food.key,
                name=part.food.name,
                version=part.food.version,
                state=stored_word(part.food.state, FOOD_STATES),
                mass_g=part.mass_g,
                retention=dict(part.retention),
                retention_source=part.retention_source,
                is_current=part.is_current,
            )
            for part in recipe.ingredients
        ],
        unknown=[
            UnknownComponentOut(
                number=component.number,
                tagname=component.tagname,
                name=component.name,
                unit=component.unit,
                coverage=coverage,
            )
            for component, coverage in recipe.unknown
        ],
    )


def _density_choice(choice: DensityChoice | None) -> DensityChoiceOut | None:
    if choice is None:
        return None
    return DensityChoiceOut(
        chosen=DensityOut(**asdict(choice.chosen)),
        reason=choice.reason,
        alternatives=[
            RejectedDensityOut(**asdict(rejected.density), reason=rejected.reason) for rejected in choice.alternatives
        ],
    )
