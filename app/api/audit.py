"""/v1/audit and /v1/studies/{study}/audit: who read photographs, who changed what: JSON pages or one streamed file."""

from itertools import chain, islice
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse

from app.api.deps import CurrentStaff, State
from app.api.export_files import MEDIA_TYPES
from app.api.flat_list import FILES, file_format
from app.api.paging import Limit
from app.api.parameters import StudyCode
from app.api.problems import problem_responses
from app.api.schemas.privacy import AuditEventOut, AuditPage
from app.api.schemas.text import AwareInstant
from app.api.state import ApiState
from app.exports.flat_rows import FlatFormat, encode_flat, flat_paths
from app.services.audit_log import NamedEvent, read_audit, stream_audit
from app.services.caller import StaffCaller

router = APIRouter(prefix="/v1", tags=["audit"])

RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {
        "model": AuditPage,
        "content": FILES,
        "description": "A page, or all events as a file.",
    },
    **problem_responses(401, 403, 404, 422),
}

Action = Annotated[str | None, Query(max_length=64, description="Such as photograph.read.")]
From = Annotated[AwareInstant | None, Query(alias="from", description="RFC 3339; included.")]
To = Annotated[AwareInstant | None, Query(alias="to", description="RFC 3339; excluded.")]

Cursor = Annotated[str | None, Query(max_length=300, description="From the page before: follow `next`.")]
Output = Annotated[
    Literal["json", "csv", "ndjson"] | None,
    Query(alias="format", description="Default: by the Accept header, else json."),
]


@router.get("/studies/{study}/audit", response_model=AuditPage, responses=RESPONSES)
def get_study_audit(
    request: Request,
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    action: Action = None,
    since: From = None,
    until: To = None,
    limit: Limit = 100,
    cursor: Cursor = None,
    _: Output = None,
) -> Response:
    """The audit log of a study, oldest first, for its owners."""
    filters = {"study_code": study, "action": action, "since": since, "until": until}
    return _answer(request, state, caller, filters, limit, cursor)


@router.get("/audit", response_model=AuditPage, responses=RESPONSES)
def get_audit(
    request: Request,
    state: State,
    caller: CurrentStaff,
    action: Action = None,
    since: From = None,
    until: To = None,
    limit: Limit = 100,
    cursor: Cursor = None,
    _: Output = None,
) -> Response:
    """The whole audit log, oldest first, for admins."""
    filters = {"study_code": None, "action": action, "since": since, "until": until}
    return _answer(request, state, caller, filters, limit, cursor)


def _answer(
    request: Request,
    state: State,
    caller: StaffCaller,
    filters: dict[str, Any],
    limit: int,
    cursor: str | None,
) -> Response:
    wanted = file_format(request)
    if wanted is not None:
        return audit_file(state, caller, filters, wanted)
    page = read_audit(state.database, caller, **filters, cursor=cursor, limit=limit)
    following = None
    if page.cursor is not None:
        others = [(key, value) for key, value in request.query_params.multi_items() if key != "cursor"]
        following = f"{request.url.path}?{urlencode([*others, ('cursor', page.cursor)])}"
    body = AuditPage(items=[_event_out(row) for row in page.rows], next=following)
    return JSONResponse(body.model_dump(mode="json"))


def audit_file(state: ApiState, caller: StaffCaller, filters: dict[str, Any], output: FlatFormat = "csv") -> Response:
    """All events of the filters as a file; details as JSON text in CSV."""
    rows = stream_audit(state.database, caller, **filters)
    first = list(islice(rows, 1))  # a database that fails gives an error document, not a broken file
    return StreamingResponse(
        encode_flat(
            output,
            flat_paths(AuditEventOut),
            (_event_out(row).model_dump(mode="json") for row in chain(first, rows)),
        ),
        media_type=MEDIA_TYPES[output],
        headers={"Content-Disposition": f'attachment; filename="audit.{output}"'},
    )


def _event_out(row: NamedEvent) -> AuditEventOut:
    event = row.event
    return AuditEventOut(
        id=event.id,
        at=event.at,
        study=row.study_code,
        actor_kind=event.actor_kind,
        actor=event.actor,
        action=event.action,
        subject=event.subject,
        details=event.details,
        request_id=event.request_id,
    )
