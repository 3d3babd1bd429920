"""/v1/studies/{study}/densities: a study's own measurements of foods, which take precedence in that study only."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from app.foods import study_densities
from app.foods.edits.api import measured_density
from app.foods.edits.edit_food import Editor
from app.foods.edits.schemas import StudyDensityIn, StudyDensityList, StudyDensityOut, WithdrawalIn
from app.foods.models import StudyDensity
from app.foods.study_densities import Measurement
from app.http.flat_list import ListRoute
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.people.access.deps import CurrentStaff, State

router = APIRouter(
    prefix="/v1/studies/{study}/densities",
    tags=["studies"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 404, 422),
)


@router.post("", status_code=201, responses=problem_responses(413))
def post_study_density(
    study: StudyCode, body: StudyDensityIn, state: State, admin: CurrentStaff, response: Response
) -> StudyDensityOut:
    """Keep a measurement. Records stay as they are: `tada records recompute --nutrients` makes new ones."""
    density, specimens = measured_density(body)
    row = study_densities.add_study_density(
        state.database,
        study,
        Measurement(body.food, density, specimens, body.measured_at),
        Editor.of(admin, body.reason),
    )
    response.headers["Location"] = f"/v1/studies/{study}/densities"
    return render_study_density(row)


@router.get("")
def get_study_densities(
    study: StudyCode,
    state: State,
    _: CurrentStaff,
    food: Annotated[
        str | None, Query(max_length=100, description="Only this food's: its key.")
    ] = None,
) -> StudyDensityList:
    """The study's measurements, withdrawn ones too, the newest entry first."""
    rows = study_densities.list_study_densities(state.database, study, food)
    return StudyDensityList(items=[render_study_density(row) for row in rows])


@router.post("/{density}/withdrawal", responses=problem_responses(409))
def post_density_withdrawal(
    study: StudyCode,
    density: Annotated[uuid.UUID, Path(description="The measurement's id.")],
    body: WithdrawalIn,
    state: State,
    admin: CurrentStaff,
) -> StudyDensityOut:
    """Take a measurement out of use. It stays to be seen, with who withdrew it and why."""
    editor = Editor.of(admin, body.reason)
    return render_study_density(
        study_densities.withdraw_study_density(state.database, study, density, editor)
    )


def render_study_density(row: StudyDensity) -> StudyDensityOut:
    """Return a measurement as the API shows it."""
    specimens = None
    if row.specimens is not None:
        specimens = [
            {"volume_ml": volume_ml, "mass_g": mass_g} for volume_ml, mass_g in row.specimens
        ]
    columns = {name: getattr(row, name) for name in StudyDensityOut.model_fields.keys() - {"food"}}
    return StudyDensityOut.model_validate(columns | {"food": row.food_key, "specimens": specimens})
