"""/v1/studies/{study}/participants: the study's participants, JSON pages or one file with their profiles."""

from fastapi import APIRouter, Request
from fastapi.responses import Response

from app.exports.export_files import FILES, Format, answer_file, file_spec, page_or_file
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit
from app.http.parameters import StudyCode
from app.http.row_filter import RowFilter
from app.people.access.deps import CurrentStaff, State
from app.people.participants import list_participants
from app.people.schemas import ParticipantList, ParticipantRow

router = APIRouter(prefix="/v1/studies", tags=["participants"])


@router.get(
    "/{study}/participants",
    response_model=ParticipantList,
    responses=page_or_file(FILES, 401, 403, 404, 422, 503),
)
def get_participants(
    request: Request,
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Format = None,
) -> Response:
    """The study's participants by code, including those who have left and whose rows are kept."""
    spec = file_spec(request, "participants", RowFilter(study), output)
    if spec is not None:
        return answer_file(state, caller, spec)
    page = list_participants(state.database, study, cursor=cursor, limit=limit)
    return ModelResponse(
        ParticipantList.of(
            request, page, lambda row: ParticipantRow.model_validate(row, from_attributes=True)
        )
    )
