"""/v1/records: what participants ate, for researchers and scripts: JSON pages or one streamed CSV."""

import csv
import io
from collections.abc import Iterator
from datetime import date
from itertools import chain, islice
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse

from app.api.deps import CurrentCaller, State
from app.api.problems import problem_responses
from app.api.render import render_record
from app.api.schemas.records import RecordOut, RecordPage
from app.db.queries.records import RecordFilter, RecordRow
from app.errors import InvalidInputError
from app.services.list_records import list_records, stream_records

router = APIRouter(prefix="/v1/records", tags=["records"])

ROWS_A_CHUNK = 200
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute such a cell
RecordStatus = Literal["proposed", "needs_review", "confirmed", "corrected", "rejected"]
CSV_COLUMNS = tuple(
    part for name in RecordOut.model_fields for part in (("food_key", "food_name") if name == "food" else (name,))
)


@router.get(
    "",
    response_model=RecordPage,
    responses={
        200: {"content": {"text/csv": {"schema": {"type": "string"}}}, "description": "A page, or all rows as CSV."},
        **problem_responses(401, 422),
    },
)
def get_records(
    request: Request,
    state: State,
    caller: CurrentCaller,
    study: Annotated[str | None, Query(max_length=64)] = None,
    participant: Annotated[str | None, Query(max_length=64)] = None,
    first_day: Annotated[date | None, Query(alias="from", description="First local day, included.")] = None,
    last_day: Annotated[date | None, Query(alias="to", description="Last local day, included.")] = None,
    food: Annotated[str | None, Query(max_length=100, description="A food's key.")] = None,
    status: Annotated[RecordStatus | None, Query()] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    cursor: Annotated[str | None, Query(max_length=300, description="From the page before: follow `next`.")] = None,
    output: Annotated[
        Literal["json", "csv"] | None, Query(alias="format", description="Default: by the Accept header, else json.")
    ] = None,
) -> Response:
    """Records in the order of capture. CSV streams all rows that the filters leave; JSON comes in pages."""
    if first_day and last_day and first_day > last_day:
        raise InvalidInputError(f"from ({first_day}) lies after to ({last_day}).", code="days_reversed")
    chosen = RecordFilter(
        study_code=study,
        participant_code=participant,
        first_day=first_day,
        last_day=last_day,
        food_key=food,
        status=status,
    )
    wants_csv = output == "csv" or (output is None and request.headers.get("accept", "").startswith("text/csv"))
    if wants_csv:
        rows = stream_records(state.database, caller, chosen)
        first = list(islice(rows, 1))  # a database that fails gives an error document, not a broken file
        return StreamingResponse(
            _csv(chain(first, rows)),
            media_type="text/csv; charset=utf-8; header=present",
            headers={"Content-Disposition": 'attachment; filename="records.csv"', "Cache-Control": "no-store"},
        )
    page = list_records(state.database, caller, chosen, cursor=cursor, limit=limit)
    following = None
    if page.cursor is not None:
        others = [(key, value) for key, value in request.query_params.multi_items() if key != "cursor"]
        following = f"{request.url.path}?{urlencode([*others, ('cursor', page.cursor)])}"
    body = RecordPage(items=[render_record(row) for row in page.rows], next=following)
    return JSONResponse(body.model_dump(mode="json"), headers={"Cache-Control": "private, no-store"})


def _csv(rows: Iterator[RecordRow]) -> Iterator[str]:
    """Header and rows, some at a time (RFC 4180)."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow(CSV_COLUMNS)
    while True:
        chunk = list(islice(rows, ROWS_A_CHUNK))
        writer.writerows(_cells(row) for row in chunk)
        yield buffer.getvalue()
        buffer.seek(0)
        buffer.truncate()
        if len(chunk) < ROWS_A_CHUNK:
            return


def _cells(row: RecordRow) -> list[object]:
    values = render_record(row).model_dump(mode="json")
    food = values.pop("food") or {"key": None, "name": None}
    values |= {"food_key": food["key"], "food_name": food["name"]}
    return [_safe(values[name]) for name in CSV_COLUMNS]


def _safe(value: object) -> object:
    """Text that a spreadsheet would take for a formula gets an apostrophe before it; a list stands in one cell."""
    if isinstance(value, list):
        value = " ".join(value)
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_STARTS) else value
