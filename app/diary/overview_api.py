"""/v1/studies/{study}/overview: a study's overview, as JSON or one of its tables as a file."""

from collections.abc import Mapping
from typing import Annotated, Literal, get_args

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, JsonValue

from app.core.errors import InvalidInputError
from app.diary.overview_schemas import (
    BinOut,
    CompletenessOut,
    FailureCountOut,
    OverviewDayOut,
    OverviewNutrientOut,
    OverviewOut,
    OverviewPeopleOut,
    OverviewStatusOut,
    PersonDayOut,
    PlaceOut,
)
from app.diary.study_overview import note_overview_export, study_overview
from app.http.file_formats import FORMATS, attachment
from app.http.flat_rows import FlatFormat, encode_flat, flat_paths
from app.http.model_response import ModelResponse
from app.http.parameters import FirstDay, LastDay, StudyCode
from app.http.problems import problem_responses
from app.people.access.deps import CurrentStaff, State

router = APIRouter(prefix="/v1/studies", tags=["days"])

Part = Literal[
    "participants",
    "completeness",
    "days",
    "statuses",
    "waiting",
    "failures",
    "nutrients",
    "histograms",
    "person_days",
    "places",
]
ROWS: Mapping[Part, type[BaseModel]] = {
    "participants": OverviewPeopleOut,
    "completeness": CompletenessOut,
    "days": OverviewDayOut,
    "statuses": OverviewStatusOut,
    "waiting": OverviewStatusOut,
    "failures": FailureCountOut,
    "nutrients": OverviewNutrientOut,
    "histograms": BinOut,
    "person_days": PersonDayOut,
    "places": PlaceOut,
}


@router.get(
    "/{study}/overview",
    response_model=OverviewOut,
    responses={
        200: {
            "content": {"text/csv": {"schema": {"type": "string"}}},
            "description": "The whole overview, or one table of it as a file.",
        },
        **problem_responses(401, 403, 404, 422),
    },
)
def get_overview(
    study: StudyCode,
    state: State,
    staff: CurrentStaff,
    first_day: FirstDay = None,
    last_day: LastDay = None,
    output: Annotated[
        Literal["json", FlatFormat],
        Query(alias="format", description="csv, ndjson: one table, which `part` names, as a file."),
    ] = "json",
    part: Annotated[
        Part | None, Query(description="Which table, with format=csv or ndjson.")
    ] = None,
) -> Response:
    """People, days, waiting meals, nutrients and places; without a range, the last 28 days with data."""
    if output != "json" and part is None:
        raise InvalidInputError(
            f"A file contains one table: part={', '.join(get_args(Part))}.",
            code="overview_part_missing",
        )
    figures = study_overview(state.database, staff, study, first_day=first_day, last_day=last_day)
    overview = OverviewOut.model_validate(figures, from_attributes=True)
    if output == "json" or part is None:
        return ModelResponse(overview)
    note_overview_export(state.database, staff, study, part, output)
    headers = attachment(output, study, f"overview-{part}", overview.first_day, overview.last_day)
    content = b"".join(encode_flat(output, flat_paths(ROWS[part]), rows_of(overview, part)))
    return Response(content, media_type=FORMATS[output].media_type, headers=headers)


def rows_of(overview: OverviewOut, part: Part) -> list[dict[str, JsonValue]]:
    """Return the rows of one table of the overview."""
    table = getattr(overview, part)
    return [row.model_dump(mode="json") for row in (table if isinstance(table, list) else [table])]
