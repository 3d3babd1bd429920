"""/v1/audit and /v1/studies/{study}/audit: who read photographs, who changed what: JSON pages or one streamed CSV."""

import csv
import io
import json
from collections.abc import Iterator
from itertools import chain, islice
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from pydantic import AwareDatetime, BeforeValidator

from app.api.deps import CurrentStaff, State
from app.api.problems import problem_responses
from app.api.schemas.privacy import AuditEventOut, AuditPage
from app.api.schemas.text import only_text
from app.api.state import ApiState
from app.services.audit_log import NamedEvent, read_audit, stream_audit
from app.services.caller import StaffCaller

router = APIRouter(prefix="/v1", tags=["audit"])

ROWS_A_CHUNK = 200
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute such a cell
RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {
        "model": AuditPage,
        "content": {"text/csv": {"schema": {"type": "string"}}},
        "description": "A page, or all events as CSV.",
    },
    **problem_responses(401, 403, 404, 422),
}

Action = Annotated[str | None, Query(max_length=64, description="Such as photograph.read.")]
From = Annotated[
    AwareDatetime | None, BeforeValidator(only_text), Query(alias="from", description="RFC 3339; included.")
]
To = Annotated[AwareDatetime | None, BeforeValidator(only_text), Query(alias="to", description="RFC 3339; excluded.")]
Limit = Annotated[int, Query(ge=1, le=1000)]
Cursor = Annotated[str | None, Query(max_length=300, description="From the page before: follow `next`.")]
Output = Annotated[
    Literal["json", "csv"] | None, Query(alias="format", description="Default: by the Accept header, else json.")
]


@router.get("/studies/{study}/audit", response_model=AuditPage, responses=RESPONSES)
def get_study_audit(
    request: Request,
    study: Annotated[str, Path(max_length=64)],
    state: State,
    caller: CurrentStaff,
    action: Action = None,
    since: From = None,
    until: To = None,
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Output = None,
) -> Response:
    """The audit log of a study, oldest first, for its owners."""
    filters = {"study_code": study, "action": action, "since": since, "until": until}
    return _answer(request, state, caller, filters, limit, cursor, output)


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
    output: Output = None,
) -> Response:
    """The whole audit log, oldest first, for admins."""
    filters = {"study_code": None, "action": action, "since": since, "until": until}
    return _answer(request, state, caller, filters, limit, cursor, output)


def _answer(
    request: Request,
    state: State,
    caller: StaffCaller,
    filters: dict[str, Any],
    limit: int,
    cursor: str | None,
    output: str | None,
) -> Response:
    if output == "csv" or (output is None and request.headers.get("accept", "").startswith("text/csv")):
        return audit_csv(state, caller, filters)
    page = read_audit(state.database, caller, **filters, cursor=cursor, limit=limit)
    following = None
    if page.cursor is not None:
        others = [(key, value) for key, value in request.query_params.multi_items() if key != "cursor"]
        following = f"{request.url.path}?{urlencode([*others, ('cursor', page.cursor)])}"
    body = AuditPage(items=[_event_out(row) for row in page.rows], next=following)
    return JSONResponse(body.model_dump(mode="json"), headers={"Cache-Control": "private, no-store"})


def audit_csv(state: ApiState, caller: StaffCaller, filters: dict[str, Any]) -> Response:
    """All events of the filters as CSV."""
    rows = stream_audit(state.database, caller, **filters)
    first = list(islice(rows, 1))  # a database that fails gives an error document, not a broken file
    return StreamingResponse(
        _csv(chain(first, rows)),
        media_type="text/csv; charset=utf-8; header=present",
        headers={"Content-Disposition": 'attachment; filename="audit.csv"', "Cache-Control": "no-store"},
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


def _csv(rows: Iterator[NamedEvent]) -> Iterator[str]:
    """Header and events, some at a time (RFC 4180); details as JSON."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow(AuditEventOut.model_fields)
    while True:
        chunk = list(islice(rows, ROWS_A_CHUNK))
        for row in chunk:
            values = _event_out(row).model_dump(mode="json")
            values["details"] = json.dumps(values["details"], sort_keys=True)
            writer.writerow([_cell(value) for value in values.values()])
        yield buffer.getvalue()
        buffer.seek(0)
        buffer.truncate()
        if not chunk:
            return


def _cell(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_STARTS) else value
