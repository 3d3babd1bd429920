"""Lists that are small tables too: `?format=csv|ndjson`, or the Accept header, gives the whole list as one flat file.

A router of class ListRoute gives it to every GET whose answer is a list of `items` (or `groups`): the same endpoint is
asked page by page, by the caller's own rights, so that a file has what the pages have. Tables that grow with meals
(records, days, photographs ...) are written in another way (export_files.py).
"""

import json
import re
import typing
from collections.abc import Callable, Coroutine
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

import anyio
from fastapi import Depends, Query, Request
from fastapi.responses import Response
from fastapi.routing import APIRoute
from pydantic import BaseModel

from app.core.errors import InvalidInputError
from app.exports.export_files import MEDIA_TYPES
from app.http.tables.flat_rows import FlatFormat, encode_flat, flat_paths

MOST_ROWS = 50_000
LIST_FIELDS = ("items", "groups")
FORMATS: tuple[FlatFormat, ...] = ("csv", "ndjson")
FILES = {MEDIA_TYPES[output].split(";")[0]: {"schema": {"type": "string"}} for output in FORMATS}

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


def list_format(
    output: Annotated[
        Literal["json", "csv", "ndjson"] | None,
        Query(alias="format", description="csv, ndjson: the whole list. Default: by the Accept header, else json."),
    ] = None,
) -> None:
    """Documents and checks the parameter; ListRoute reads it."""


class ListRoute(APIRoute):
    """A route whose list leaves as a file too."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:
        self._row = row_of(endpoint) if options.get("methods") in (["GET"], {"GET"}) else None
        if self._row is not None:
            options["dependencies"] = [*(options.get("dependencies") or ()), Depends(list_format)]
            options["responses"] = {
                200: {"content": FILES, "description": "A page, or the whole list as a file."},
                **(options.get("responses") or {}),
            }
        super().__init__(path, endpoint, **options)

    def get_route_handler(self) -> Handler:
        """The endpoint's own handler; for a file it is asked again and again."""
        handler, row = super().get_route_handler(), self._row
        if row is None:
            return handler
        name = re.sub(r"[{}]", "", self.path.rsplit("/", 1)[-1])
        limit = self._greatest_limit()

        async def handle(request: Request) -> Response:
            output = file_format(request)
            if output is None:
                return await handler(request)
            rows = await _all_rows(handler, request, limit)
            content = await anyio.to_thread.run_sync(lambda: b"".join(encode_flat(output, flat_paths(row, rows), rows)))
            headers = {
                "Content-Disposition": f'attachment; filename="{name}.{output}"',
            }
            return Response(content, media_type=MEDIA_TYPES[output], headers=headers)

        return handle

    def _greatest_limit(self) -> int | None:
        """Of the endpoint's `limit`; None: the list comes whole."""
        for field in self.dependant.query_params:
            if field.alias == "limit":
                return int(next(one.le for one in field.field_info.metadata if hasattr(one, "le")))
        return None


def row_of(endpoint: Callable[..., Any]) -> type[BaseModel] | None:
    """The model of the rows that an endpoint lists; None: it lists none, or takes care of files itself."""
    told = typing.get_type_hints(endpoint)
    answer = told.get("return")
    if "output" in told or not (isinstance(answer, type) and issubclass(answer, BaseModel)):
        return None
    for name in LIST_FIELDS:
        field = answer.model_fields.get(name)
        if field is not None and typing.get_origin(field.annotation) is list:
            (row,) = typing.get_args(field.annotation)
            return row if isinstance(row, type) and issubclass(row, BaseModel) else None
    return None


def file_format(request: Request) -> FlatFormat | None:
    """The file that is asked for, by the parameter or else by the header; None: JSON."""
    asked, accept = request.query_params.get("format"), request.headers.get("accept", "")
    for output in FORMATS:
        if asked == output or (asked is None and accept.startswith(MEDIA_TYPES[output].split(";")[0])):
            return output
    return None


async def _all_rows(handler: Handler, request: Request, limit: int | None) -> list[dict[str, Any]]:
    """Of all pages. The first call counts as an export, those that follow it as calls (call_limits.py).

    Raises InvalidInputError (`list_too_long`), and what the endpoint raises.
    """
    kept = [(name, value) for name, value in request.query_params.multi_items() if name not in ("limit", "cursor")]
    if limit is not None:
        kept.append(("limit", str(limit)))
    rows: list[dict[str, Any]] = []
    query = kept
    while True:
        scope = {**request.scope, "query_string": urlencode(query).encode()}
        answer = json.loads(bytes((await handler(Request(scope, request.receive))).body))
        rows += next(answer[name] for name in LIST_FIELDS if name in answer)
        if len(rows) > MOST_ROWS:
            raise InvalidInputError(
                f"The list has more than {MOST_ROWS:,} rows: narrow it by a filter, or follow the pages of JSON.",
                code="list_too_long",
                limit_rows=MOST_ROWS,
            )
        following = answer.get("next")
        if following is None:
            return rows
        cursor = dict(Request({"type": "http", "query_string": following.partition("?")[2].encode()}).query_params)
        others = [(name, value) for name, value in kept if name != "format"]
        query = [*others, ("format", "json"), ("cursor", cursor["cursor"])]
