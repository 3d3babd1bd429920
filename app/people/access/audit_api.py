"""/v1/audit and /v1/studies/{study}/audit: the audit log as JSON pages or one streamed file.

Owners read that of their study, admins all of it.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from datetime import UTC, date, datetime, timedelta
from itertools import chain, islice
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import Response, StreamingResponse
from pydantic import BaseModel, Field

from app.db.session import Database
from app.http.file_formats import FORMATS, attachment
from app.http.flat_list import FILES, FlatFormat, encode_flat, flat_paths, negotiated_format
from app.http.model_response import ModelResponse
from app.http.page_of import PageOf
from app.http.paging import (
    WHOLE_NUMBER,
    Limit,
    Page,
    all_rows,
    decode_cursor,
    page_of,
    require_order,
)
from app.http.parameters import StudyCode
from app.http.problems import Responses, problem_responses
from app.http.state import ApiState
from app.http.text_schemas import AwareInstant
from app.people import privacy_queries as privacy
from app.people.access.caller import StaffCaller
from app.people.access.deps import CurrentStaff, State
from app.people.privacy_models import ActorKind
from app.people.privacy_queries import AuditFilter, AuditRow
from app.people.studies import enter_study


class AuditEventOut(BaseModel):
    """A read of photographs or a change. People appear by an alias that only their row resolves."""

    id: int = Field(description="Grows with each event.")
    at: datetime = Field(description="When it happened.")
    study: str | None = Field(
        description="The study's code; null: the event belongs to no existing study."
    )
    actor_kind: ActorKind = Field(description="staff, device or system")
    actor: str = Field(description="A staff member's name, a participant's alias, or system.")
    action: str = Field(description="What was done, such as photograph.read or study.change.")
    subject: str | None = Field(
        description="Alias or name of the person or object concerned; null: none."
    )
    details: dict[str, object] = Field(
        description="Further details; the fields depend on the action."
    )
    request_id: str | None = Field(
        description="The request's id in the server's log; null: not caused by a request."
    )


class AuditPage(PageOf[AuditEventOut]):
    """A page of events in order; `next` is the address of the next page, or null."""


STREAM_PAGE = 1000
router = APIRouter(prefix="/v1", tags=["audit"], responses=problem_responses(401, 403, 404, 422))

RESPONSES: Responses = {
    200: {"model": AuditPage, "content": FILES, "description": "A page, or all events as a file."},
}
BEFORE_ALL = datetime(2000, 1, 1, tzinfo=UTC)  # no event is older

Cursor = Annotated[
    str | None, Query(max_length=300, description="From the previous page: follow `next`.")
]
Output = Annotated[
    Literal["json", FlatFormat] | None,
    Query(alias="format", description="Default: by the Accept header, else json."),
]


def read_audit(
    database: Database,
    caller: StaffCaller,
    study_code: str | None,
    chosen: AuditFilter,
    *,
    cursor: str | None,
    limit: int,
    is_newest_first: bool = False,
) -> Page[AuditRow]:
    """Return a page of events, the oldest first unless asked otherwise. study_code None: of all studies, for an admin.

    Raises NotFoundError, NotAllowedError, InvalidInputError for a cursor of another filter.
    """
    require_order(chosen.since, chosen.until)
    with database.read() as session:
        if study_code is not None:
            chosen = replace(chosen, study_id=enter_study(session, caller, study_code).id)
        list_name = f"audit {is_newest_first} " + json.dumps(
            asdict(chosen), default=str, sort_keys=True
        )
        after = decode_cursor(list_name, cursor, WHOLE_NUMBER)
        rows = privacy.page_of_audit(
            session, chosen, after=after, limit=limit + 1, is_newest_first=is_newest_first
        )
    return page_of(list_name, rows, limit, lambda row: row.id)


def stream_audit(
    database: Database, caller: StaffCaller, study_code: str | None, chosen: AuditFilter
) -> Iterator[AuditRow]:
    """Stream all events that match the filter, a page per query."""
    return all_rows(
        lambda cursor: read_audit(
            database, caller, study_code, chosen, cursor=cursor, limit=STREAM_PAGE
        )
    )


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
    return ModelResponse(AuditPage.of(request, page, _event_out))


def audit_file(
    state: ApiState,
    caller: StaffCaller,
    study: str | None,
    chosen: AuditFilter,
    output: FlatFormat = "csv",
) -> Response:
    """Return all events that match the filter as a file; details are JSON text in CSV."""
    rows = stream_audit(state.database, caller, study, chosen)
    # read before the response begins, so that a failing database gives an error document
    first = list(islice(rows, 1))
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
