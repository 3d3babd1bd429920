"""/v1/foods: the active food table."""

from typing import Annotated

from fastapi import APIRouter, Path, Query

from app.api.deps import CurrentCaller, State
from app.api.problems import problem_responses
from app.api.schemas.records import DensityOut, FoodList, FoodOut, FoodSummary, NutrientOut
from app.services.foods import read_food, search_foods

router = APIRouter(prefix="/v1/foods", tags=["foods"])


@router.get("", responses=problem_responses(401, 422))
def get_foods(
    state: State,
    _: CurrentCaller,
    q: Annotated[
        str | None, Query(min_length=1, max_length=100, description="Words of a name or alias, begun or whole.")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> FoodList:
    """Foods, best match first; without `q`, in the table's order."""
    return FoodList(
        items=[
            FoodSummary(key=row.key, name=row.name, aliases=row.aliases, group=row.food_group, form=row.form)
            for row in search_foods(state.database, q, limit)
        ]
    )


@router.get("/{key}", responses=problem_responses(401, 404, 422))
def get_food(state: State, _: CurrentCaller, key: Annotated[str, Path(max_length=100)]) -> FoodOut:
    """One food: nutrients per 100 g edible portion, densities with their sources, refuse by part."""
    view = read_food(state.database, key)
    return FoodOut(
        key=view.food.key,
        name=view.food.name,
        aliases=view.food.aliases,
        group=view.food.food_group,
        form=view.food.form,
        refuse=view.food.refuse,
        source_ids=view.food.source_ids,
        release=view.release,
        densities=[DensityOut.model_validate(density, from_attributes=True) for density in view.densities],
        nutrients=[
            NutrientOut(tagname=tagname, name=name, unit=unit, per_100_g=amount)
            for tagname, name, unit, amount in view.nutrients
        ],
    )
