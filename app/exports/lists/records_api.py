"""/v1/records: what participants ate, as JSON pages or as one streamed file."""

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import Response

from app.exports.export_files import (
    FILES_WITH_PLACES,
    ComponentsIn,
    Format,
    LayoutIn,
    ProvenanceIn,
    answer_file,
    file_spec,
    page_or_file,
    record_filter,
)
from app.exports.known_filters import require_known
from app.exports.lists.list_records import list_records
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit
from app.http.row_filter import RowFilter
from app.people.access.deps import CurrentCaller, State
from app.records.render import render_record
from app.records.schemas import RecordPage

router = APIRouter(prefix="/v1/records", tags=["records"])


@router.get(
    "",
    response_model=RecordPage,
    responses=page_or_file(FILES_WITH_PLACES, 401, 404, 422, 503),
)
def get_records(
    request: Request,
    state: State,
    caller: CurrentCaller,
    chosen: Annotated[RowFilter, Depends(record_filter)],
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Format = None,
    layout: LayoutIn = "wide",
    components: ComponentsIn = "headline",
    provenance: ProvenanceIn = True,
) -> Response:
    """Records in the order of capture, as JSON pages or a file of all matching rows of one moment."""
    require_known(state.database, caller, chosen)
    spec = file_spec(request, "items", chosen, output, layout, components, provenance=provenance)
    if spec is not None:
        return answer_file(state, caller, spec)
    page = list_records(state.database, caller, chosen, cursor=cursor, limit=limit)
    return ModelResponse(RecordPage.of(request, page, render_record))
