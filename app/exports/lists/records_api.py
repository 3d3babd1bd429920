"""/v1/records: what participants ate, for researchers and scripts: JSON pages, or all as one streamed file."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import StringConstraints

from app.exports.export_files import (
    FILES_WITH_PLACES,
    ComponentsIn,
    Format,
    LayoutIn,
    ProvenanceIn,
    answer_file,
    file_format,
)
from app.exports.export_spec import ExportFilters, ExportSpec
from app.exports.lists.list_records import list_records
from app.http.day_order import require_order
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import FirstDay, LastDay, OfParticipant, OfStudy
from app.http.problems import problem_responses
from app.meals.record_models import RecordStatus
from app.people.access.deps import CurrentCaller, State
from app.records.page_queries import RecordFilter
from app.records.render import render_record
from app.records.schemas import RecordPage

router = APIRouter(prefix="/v1/records", tags=["records"])

FoodKey = Annotated[str, StringConstraints(max_length=100)]
MOST_FOODS = 10  # in one filter: each is found in an index by itself


@router.get(
    "",
    response_model=RecordPage,
    responses={
        200: {"content": FILES_WITH_PLACES, "description": "A page, or all rows as a file."},
        **problem_responses(401, 422, 503),
    },
)
def get_records(
    request: Request,
    state: State,
    caller: CurrentCaller,
    study: OfStudy = None,
    participant: OfParticipant = None,
    first_day: FirstDay = None,
    last_day: LastDay = None,
    food: Annotated[
        list[FoodKey] | None, Query(max_length=MOST_FOODS, description="A food's key; any of several.")
    ] = None,
    status: Annotated[
        list[RecordStatus] | None, Query(max_length=5, description="The items' status; any of several.")
    ] = None,
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Format = None,
    layout: LayoutIn = "wide",
    components: ComponentsIn = "headline",
    provenance: ProvenanceIn = True,
) -> Response:
    """Records in the order of capture. JSON comes in pages; a file has all that the filters leave, of one moment."""
    output = file_format(request, output, layout, components)
    if output is not None:
        filters = ExportFilters(
            study, participant, first_day, last_day, food_keys=tuple(food or ()), statuses=tuple(status or ())
        )
        spec = ExportSpec("items", layout, output, components, filters, provenance)
        return answer_file(state, caller, spec, "records")
    require_order(first_day, last_day)
    chosen = RecordFilter(
        study_code=study,
        participant_code=participant,
        first_day=first_day,
        last_day=last_day,
        food_keys=tuple(food or ()),
        statuses=tuple(status or ()),
    )
    page = list_records(state.database, caller, chosen, cursor=cursor, limit=limit)
    body = RecordPage(items=[render_record(row) for row in page.rows], next=next_page(request, page.cursor))
    return JSONResponse(body.model_dump(mode="json"))
