"""/v1/studies/{study}/reference-days, .../reference-agreement: days by another method, and how far they agree."""

from typing import Annotated

from fastapi import APIRouter, Body, Response

from app.diary.references.compare_reference import compare_with_reference
from app.diary.references.reference_days import replace_reference
from app.diary.references.schemas import ReferenceAgreement
from app.http.flat_list import ListRoute
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.people.access.deps import CurrentStaff, State
from app.people.studies import load_study

router = APIRouter(
    prefix="/v1/studies/{study}",
    tags=["days"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 404, 422),
)


@router.put(
    "/reference-days", status_code=204, response_class=Response, responses=problem_responses(413)
)
def put_reference(
    study: StudyCode,
    body: Annotated[
        bytes,
        Body(
            media_type="text/csv",
            description="Columns as in the export of days: participant, local_date, nutrients.",
        ),
    ],
    state: State,
    caller: CurrentStaff,
) -> None:
    """Replace all reference days of the study by those of a CSV file."""
    replace_reference(state.database, caller, study, body)


@router.get("/reference-agreement")
def get_reference_agreement(study: StudyCode, state: State, _: CurrentStaff) -> ReferenceAgreement:
    """How far participants' means agree with the reference, over the same days, by nutrient."""
    with state.database.read() as session:
        compared = compare_with_reference(session, load_study(session, study).id)
    return ReferenceAgreement(items=[figures for figures, _ in compared])
