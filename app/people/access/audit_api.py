"""/v1/audit and /v1/studies/{study}/audit: the audit log as JSON pages or one streamed file."""

from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta
from itertools import chain, islice
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import Response, StreamingResponse

from app.http.file_formats import FORMATS, attachment
from app.http.flat_list import FILES, negotiated_format
from app.http.flat_rows import FlatFormat, encode_flat, flat_paths
from app.http.model_response import ModelResponse
from app.http.paging import Limit, next_page
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.http.state import ApiState
from app.http.text_schemas import AwareInstant
from app.people.access.audit_log import read_audit, stream_audit
from app.people.access.audit_schemas import AuditEventOut, AuditPage
from app.people.access.caller import StaffCaller
from app.people.access.deps import CurrentStaff, State
from app.people.privacy_queries import AuditFilter, AuditRow

router = APIRouter(prefix="/v1", tags=["audit"])

RESPONSES = {
    200: {"model": AuditPage, "content": FILES, "description": "A page, or all events as a file."},
    **problem_responses(401, 403, 404, 422),
}
BEFORE_ALL = datetime(2000, 1, 1, tzinfo=UTC)  # no event is older

Cursor = Annotated[
    str | None, Query(max_length=300, description="From the previous page: follow `next`.")
]
Output = Annotated[
    Literal["json", FlatFormat] | None,
    Query(alias="format", description="Default: by the Accept header, else json."),
]


def _chosen(
    action: Annotated[
        str | None, Query(max_length=64, description="An action, such as photograph.read.")
    ] = None,
    since: Annotated[
        AwareInstant | None, Query(alias="from", description="RFC 3339; included.")
    ] = None,
    until: Annotated[
        AwareInstant | None, Query(alias="to", description="RFC 3339; excluded.")
    ] = None,
) -> AuditFilter:
    return AuditFilter(action=action, since=since, until=until)


Chosen = Annotated[AuditFilter, Depends(_chosen)]


@router.get("/studies/{study}/audit", response_model=AuditPage, responses=RESPONSES)
def get_study_audit(
    request: Request,
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    chosen: Chosen,
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Output = None,
) -> Response:
    """The audit log of a study, oldest first, for its owners."""
    return _answer(request, state, caller, study, chosen, limit, cursor, output)


@router.get("/audit", response_model=AuditPage, responses=RESPONSES)
def get_audit(
    request: Request,
    state: State,
    caller: CurrentStaff,
    chosen: Chosen,
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Output = None,
) -> Response:
    """The whole audit log, oldest first, for admins."""
    return _answer(request, state, caller, None, chosen, limit, cursor, output)


def _answer(
    request: Request,
    state: ApiState,
    caller: StaffCaller,
    study: str | None,
    chosen: AuditFilter,
    limit: int,
    cursor: str | None,
    output: Literal["json", FlatFormat] | None,
) -> Response:
    file_format = negotiated_format(request, output)
    if file_format is not None:
        return audit_file(state, caller, study, chosen, file_format)
    page = read_audit(state.database, caller, study, chosen, cursor=cursor, limit=limit)
    body = AuditPage(
        items=[_event_out(row) for row in page.rows], next=next_page(request, page.cursor)
    )
    return ModelResponse(body)


def audit_file(
    state: ApiState,
    caller: StaffCaller,
    study: str | None,
    chosen: AuditFilter,
    output: FlatFormat = "csv",
) -> Response:
    """Return all events that match the filter as a file; details are JSON text in CSV."""
    rows = stream_audit(state.database, caller, study, chosen)
    first = list(
        islice(rows, 1)
    )  # read before the response begins, so that a failing database gives an error document
    return StreamingResponse(
        encode_flat(
            output,
            flat_paths(AuditEventOut),
            (_event_out(row).model_dump(mode="json") for row in chain(first, rows)),
        ),
        media_type=FORMATS[output].media_type,
        headers=attachment(output, study, "audit", *_days(chosen)),
    )


def _days(chosen: AuditFilter) -> Iterator[date | None]:
    """Yield the first and the last UTC day of the filter, None where it has no end."""
    last = None if chosen.until is None else max(chosen.until, BEFORE_ALL) - timedelta.resolution
    for instant in (chosen.since, last):
        yield None if instant is None else instant.astimezone(UTC).date()


def _event_out(row: AuditRow) -> AuditEventOut:
    return AuditEventOut.model_validate(row, from_attributes=True)
