"""/v1/studies/{study}/overview and adequacy, /v1/me/summary: what days come to, of a study and of one participant."""

from collections.abc import Mapping
from typing import Annotated, Literal, get_args

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, JsonValue

from app.core.errors import InvalidInputError
from app.diary.adequacy import judge_study
from app.diary.diary import ParticipantRef
from app.diary.feedback import read_feedback
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
from app.diary.progress import study_flow, study_progress
from app.diary.progress_schemas import FlowOut, ProgressFilterIn, ProgressOut
from app.diary.schemas import AdequacyOut, SummaryOut
from app.diary.study_overview import note_overview_export, study_overview
from app.http.file_formats import FORMATS, attachment
from app.http.flat_list import FlatFormat, ListRoute, encode_flat, flat_paths
from app.http.model_response import ModelResponse
from app.http.paging import require_order
from app.http.parameters import FirstDay, LastDay, ParticipantCode, StudyCode
from app.http.problems import problem_responses
from app.http.text_schemas import LocalDay
from app.nutrition.intakes.compare_intake import MIN_DAYS
from app.people.access.deps import CurrentDevice, CurrentStaff, State

router = APIRouter()
overviews = APIRouter(prefix="/v1/studies", tags=["days"])

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


@overviews.get(
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


lists = APIRouter(
    prefix="/v1/studies",
    tags=["days"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 404, 422),
)


@lists.get("/{study}/adequacy")
def get_adequacy(
    study: StudyCode,
    state: State,
    staff: CurrentStaff,
    component: Annotated[
        str, Query(max_length=64, description="Number, tagname or record's column: 401, VITC.")
    ],
    first_day: FirstDay = None,
    last_day: LastDay = None,
) -> AdequacyOut:
    """Each life stage's persons, days, variances and share below the EAR, or the reason why there is no share."""
    require_order(first_day, last_day)
    return judge_study(
        state.database, staff, study, component, first_day=first_day, last_day=last_day
    )


@lists.get("/{study}/progress")
def get_progress(
    study: StudyCode, state: State, staff: CurrentStaff, chosen: ProgressFilterIn
) -> ProgressOut:
    """Progress of each participant; without a range, days are the 28 up to yesterday."""
    return study_progress(state.database, staff, study, chosen)


LeastDays = Annotated[
    int,
    Query(ge=1, le=366, description="Complete days with which a participant is analysed."),
]


@lists.get("/{study}/flow")
def get_flow(
    study: StudyCode, state: State, staff: CurrentStaff, least_days: LeastDays = MIN_DAYS
) -> FlowOut:
    """The study's flow from registered to analysed participants, by arm."""
    return study_flow(state.database, staff, study, least_days)


summaries = APIRouter(prefix="/v1", tags=["feedback"], responses=problem_responses(401, 403, 422))

Day = Annotated[
    LocalDay | None,
    Query(
        alias="date", description="A local day; default: the last one with a meal or a diary entry."
    ),
]


@summaries.get("/me/summary", responses=problem_responses(410))
def get_my_summary(state: State, device: CurrentDevice, day: Day = None) -> SummaryOut:
    """A day's amounts and, from three closed days on, a comparison; only if the study gives feedback."""
    return read_feedback(state.database, device, day)


@summaries.get(
    "/studies/{study}/participants/{participant}/summary", responses=problem_responses(404)
)
def get_summary_of_participant(
    study: StudyCode,
    participant: ParticipantCode,
    state: State,
    staff: CurrentStaff,
    day: Day = None,
) -> SummaryOut:
    """What the participant sees, or would see if the study gave feedback."""
    return read_feedback(state.database, staff, day, ParticipantRef(study, participant))


for part_of_diary in (overviews, lists, summaries):
    router.include_router(part_of_diary)
