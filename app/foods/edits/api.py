"""/v1/foods, writing: an admin creates and corrects foods; each change is a version with author and reason."""

from collections.abc import Sequence
from typing import cast

from fastapi import APIRouter, Response

from app.core.units import Unit
from app.foods.api import FoodKey, etag_of, render_food
from app.foods.component_names import Figure
from app.foods.edits import edit_food
from app.foods.edits.edit_food import Editor, FoodEdit, FoodFields
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
from app.http.flat_list import ListRoute
from app.http.parameters import IfMatch, expected_versions
from app.http.problems import problem_responses
from app.nutrition.foods import Density, RefusePart
from app.nutrition.portion_density import Specimen
from app.nutrition.portions import Portion
from app.people.access.deps import CurrentStaff, State

router = APIRouter(
    prefix="/v1/foods",
    tags=["foods"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 422),
)


@router.post("", status_code=201, responses=problem_responses(409, 413))
def post_food(body: FoodIn, state: State, admin: CurrentStaff, response: Response) -> FoodOut:
    """Make a food; with a recipe its figures follow from the ingredients, their retention and the yield."""
    view = edit_food.create_food(
        state.database, body.key, new_food_edit(body), Editor.of(admin, body.reason)
    )
    response.headers["Location"] = f"/v1/foods/{body.key}"
    return _tagged(view, response)


@router.patch("/{key}", responses=problem_responses(404, 409, 412, 413, 428))
def patch_food(
    key: FoodKey,
    body: FoodPatch,
    state: State,
    admin: CurrentStaff,
    response: Response,
    if_match: IfMatch = None,
) -> FoodOut:
    """Correct a food: only the fields that are named. `If-Match` names the version that the correction is of."""
    view = edit_food.edit_food(
        state.database,
        key,
        food_edit(body),
        Editor.of(admin, body.reason),
        expected=expected_versions(if_match),
    )
    return _tagged(view, response)


@router.post("/{key}/densities", status_code=201, responses=problem_responses(404, 409, 412, 413))
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
    view = edit_food.add_density(
        state.database, key, density, Editor.of(admin, body.reason), expected=expected
    )
    response.headers["Location"] = f"/v1/foods/{view.value.key}"
    return _tagged(view, response)


@router.post("/{key}/restore", responses=problem_responses(404, 409, 412, 428))
def post_restore(
    key: FoodKey,
    body: RestoreIn,
    state: State,
    admin: CurrentStaff,
    response: Response,
    if_match: IfMatch = None,
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


@router.get("/{key}/changes", responses=problem_responses(404))
def get_food_changes(key: FoodKey, state: State, _: CurrentStaff) -> ChangeList:
    """Who changed a food, when and why, and what; the newest change first."""
    return render_changes(edit_food.list_changes(state.database, key))


def render_changes(changes: Sequence[Change]) -> ChangeList:
    """Return a food's changes as the API shows them."""
    return ChangeList(
        items=[
            ChangeOut(
                version=change.food.version,
                previous_version=change.previous.version if change.previous else None,
                previous_release=change.previous_release.title if change.previous_release else None,
                author=change.change.author,
                reason=change.change.reason,
                changed_at=change.change.changed_at,
                differences={
                    name: (old, new) for name, (old, new) in change.change.differences.items()
                },
            )
            for change in changes
        ]
    )


def new_food_edit(body: FoodIn) -> FoodEdit:
    """Return the edit that creates a food. With a recipe it defaults to a mixed dish, as eaten."""
    edit = food_edit(body)
    defaults: FoodFields = (
        {} if body.recipe is None else {"is_mixed_dish": True, "state": "as_eaten"}
    )
    return FoodEdit({**defaults, **edit.fields}, edit.nutrients, edit.recipe)


def food_edit(body: FoodIn | FoodPatch) -> FoodEdit:
    """Return the fields present in a body, as values of the food table."""
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
    """Return a measured density's body as a value, and the specimens that it was computed from."""
    specimens = [
        Specimen("", specimen.volume_ml, specimen.mass_g) for specimen in body.specimens or ()
    ]
    source = body.method
    if specimens:
        g_per_ml, sd_g_per_ml = density_of_specimens(specimens, body.volume_step_ml)
        source = f"{body.method}: median of {len(specimens)} specimens"
    else:
        # the schema has checked that both are given
        g_per_ml, sd_g_per_ml = body.g_per_ml or 0.0, body.sd_g_per_ml or 0.0
    return Density(
        g_per_ml, sd_g_per_ml, body.state, body.kind, "measured", source, body.weighs
    ), specimens


def _tagged(view: FoodView, response: Response) -> FoodOut:
    response.headers["ETag"] = etag_of(view)
    return render_food(view)


def _fields(body: FoodFieldsIn) -> FoodFields:
    """Return the fields present in the body, by their names in nutrition/foods.py."""
    names = {"food_group" if name == "group" else name for name in body.model_fields_set}
    fields: FoodFields = {
        "name": body.name,
        "food_group": body.group,
        "form": body.form,
        "aliases": tuple(body.aliases),
        "slice_form": body.slice_form,
        "state": body.state,
        "is_mixed_dish": body.is_mixed_dish,
        "refuse": tuple(
            RefusePart(part.part, part.percent, part.is_served) for part in body.refuse
        ),
        "densities": tuple(Density(**density.model_dump()) for density in body.densities),
        "portions": tuple(
            Portion(str(number), portion.amount, portion.measure, portion.mass_g)
            for number, portion in enumerate(body.portions, start=1)
        ),
        "probes": tuple(body.probes),
        "source_ids": body.source_ids,
    }
    return cast("FoodFields", {name: value for name, value in fields.items() if name in names})


def _recipe(body: RecipeIn) -> NamedRecipe:
    return NamedRecipe(
        body.yield_factor,
        [NamedIngredient(**part.model_dump()) for part in body.ingredients],
    )
