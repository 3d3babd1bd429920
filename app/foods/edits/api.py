"""/v1/foods, the writing part: an admin makes and corrects foods, each change a version with author and reason."""

from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Response

from app.core.units import Unit
from app.foods.api import FoodKey, etag_of, render_food
from app.foods.component_names import Figure
from app.foods.edits import edit_food
from app.foods.edits.edit_food import Editor, FoodEdit
from app.foods.edits.queries import Change
from app.foods.edits.schemas import (
    ChangeList,
    ChangeOut,
    FoodFieldsIn,
    FoodIn,
    FoodPatch,
    MeasuredDensityIn,
    RecipeIn,
    RestoreIn,
)
from app.foods.foods import FoodView
from app.foods.recipes import NamedIngredient, NamedRecipe
from app.foods.schemas import FoodOut
from app.foods.study_densities import density_of_specimens
from app.http.conditions import IfMatch, expected_versions
from app.http.flat_list import ListRoute
from app.http.problems import problem_responses
from app.nutrition.foods import Density, RefusePart
from app.nutrition.portions import Portion
from app.nutrition.specimens import Specimen
from app.people.access.deps import CurrentStaff, State

router = APIRouter(prefix="/v1/foods", tags=["foods"], route_class=ListRoute)

_PARTS = {"refuse": RefusePart, "densities": Density}


@router.post("", status_code=201, responses=problem_responses(401, 403, 409, 413, 422))
def post_food(body: FoodIn, state: State, admin: CurrentStaff, response: Response) -> FoodOut:
    """Make a food; with a recipe its figures follow from the ingredients, their retention and the yield."""
    view = edit_food.create_food(state.database, body.key, new_food_edit(body), Editor.of(admin, body.reason))
    response.headers["Location"] = f"/v1/foods/{body.key}"
    return _tagged(view, response)


@router.patch("/{key}", responses=problem_responses(401, 403, 404, 409, 412, 413, 422, 428))
def patch_food(
    key: FoodKey, body: FoodPatch, state: State, admin: CurrentStaff, response: Response, if_match: IfMatch = None
) -> FoodOut:
    """Correct a food: only the fields that are named. `If-Match` names the version that the correction is of."""
    view = edit_food.edit_food(
        state.database, key, food_edit(body), Editor.of(admin, body.reason), expected=expected_versions(if_match)
    )
    return _tagged(view, response)


@router.post("/{key}/densities", status_code=201, responses=problem_responses(401, 403, 404, 409, 412, 413, 422))
def post_density(
    key: FoodKey,
    body: MeasuredDensityIn,
    state: State,
    admin: CurrentStaff,
    response: Response,
    if_match: IfMatch = None,
) -> FoodOut:
    """Add a measured density to a food, before its others. For one study's own use `/v1/studies/{study}/densities`."""
    density, _ = measured_density(body)
    expected = None if if_match is None else expected_versions(if_match)
    view = edit_food.add_density(state.database, key, density, Editor.of(admin, body.reason), expected=expected)
    response.headers["Location"] = f"/v1/foods/{view.value.key}"
    return _tagged(view, response)


@router.post("/{key}/restore", responses=problem_responses(401, 403, 404, 409, 412, 422, 428))
def post_restore(
    key: FoodKey, body: RestoreIn, state: State, admin: CurrentStaff, response: Response, if_match: IfMatch = None
) -> FoodOut:
    """Put a food back to an earlier version, by a new one that equals it."""
    view = edit_food.restore_food(
        state.database,
        key,
        body.version,
        Editor.of(admin, body.reason),
        expected=expected_versions(if_match),
    )
    return _tagged(view, response)


@router.get("/{key}/changes", responses=problem_responses(401, 403, 404, 422))
def get_food_changes(key: FoodKey, state: State, _: CurrentStaff) -> ChangeList:
    """Who changed a food, when and why, and what; the newest change first."""
    return render_changes(edit_food.list_changes(state.database, key))


def render_changes(changes: Sequence[Change]) -> ChangeList:
    """A food's changes as the API shows them."""
    return ChangeList(
        items=[
            ChangeOut(
                version=found.food.version,
                previous_version=found.previous.version if found.previous else None,
                previous_release=found.previous_release.title if found.previous_release else None,
                author=found.change.author,
                reason=found.change.reason,
                changed_at=found.change.changed_at,
                differences={name: (old, new) for name, (old, new) in found.change.differences.items()},
            )
            for found in changes
        ]
    )


def new_food_edit(body: FoodIn) -> FoodEdit:
    """A new food's body as the edit that makes it. With a recipe it is a mixed dish, as eaten, unless it says else."""
    edit = food_edit(body)
    usual = {} if body.recipe is None else {"is_mixed_dish": True, "state": "as_eaten"}
    return FoodEdit({**usual, **edit.fields}, edit.nutrients, edit.recipe)


def food_edit(body: FoodIn | FoodPatch) -> FoodEdit:
    """The fields that a body names, as values of the food table."""
    return FoodEdit(
        fields=_fields(body),
        nutrients={
            name: None if figure is None else Figure(figure.per_100_g, Unit(figure.unit))
            for name, figure in body.nutrients.items()
        },
        recipe=_recipe(body.recipe) if body.recipe is not None else None,
        without_recipe="recipe" in body.model_fields_set and body.recipe is None,
    )


def measured_density(body: MeasuredDensityIn) -> tuple[Density, list[Specimen]]:
    """A measured density's body as a value, and the specimens that it follows from."""
    specimens = [Specimen("", specimen.volume_ml, specimen.mass_g) for specimen in body.specimens or ()]
    source = body.method
    if specimens:
        g_per_ml, sd_g_per_ml = density_of_specimens(specimens, body.volume_step_ml)
        source = f"{body.method}: median of {len(specimens)} specimens"
    else:
        g_per_ml, sd_g_per_ml = body.g_per_ml or 0.0, body.sd_g_per_ml or 0.0  # the schema has seen that both are there
    return Density(g_per_ml, sd_g_per_ml, body.state, body.kind, "measured", source, body.weighs), specimens


def _tagged(view: FoodView, response: Response) -> FoodOut:
    response.headers["ETag"] = etag_of(view)
    return render_food(view)


def _fields(body: FoodFieldsIn) -> dict[str, Any]:
    """The fields that the body names, as a food of nutrition/foods.py has them."""
    named = body.model_fields_set & FoodFieldsIn.model_fields.keys() - {"recipe"}
    fields = {
        "food_group" if name == "group" else name: tuple(value) if isinstance(value, list) else value
        for name, value in body.model_dump(include=named).items()
    }
    for name, part_of in _PARTS.items():
        if name in fields:
            fields[name] = tuple(part_of(**part) for part in fields[name])
    if "portions" in fields:
        fields["portions"] = tuple(Portion(str(n), **part) for n, part in enumerate(fields["portions"], start=1))
    return fields


def _recipe(body: RecipeIn) -> NamedRecipe:
    return NamedRecipe(
        body.yield_factor,
        [NamedIngredient(**part.model_dump()) for part in body.ingredients],
    )
