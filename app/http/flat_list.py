"""Lists that are small tables too: `?format=csv|ndjson`, or the Accept header, gives a file.

A router of class ListRoute gives it to every GET whose answer is a list of `items` (or `groups`):
the same endpoint is called page by page, with the caller's own rights, so that a file has what the
pages have. Tables that grow with meals (records, days, photographs ...) are written in another way
(export_files.py).

A file's columns follow from the row's schema. What is nested is a column each, its names joined by
`_` (food.key -> food_key); a list of words or numbers stands in one CSV cell, a blank between; what
is a list of objects, or free, is JSON text there. Text that a spreadsheet would compute has an
apostrophe before it.
"""

import csv
import functools
import inspect
import io
import json
import re
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Annotated, Any, Literal
from urllib.parse import parse_qs

from fastapi import Depends, Query, Request
from fastapi.responses import Response
from fastapi.routing import APIRoute
from pydantic import BaseModel, JsonValue
from pydantic_core import to_json

from app.core.errors import InvalidInputError
from app.http.file_formats import FORMATS, asked_format, attachment

# a spreadsheet would compute such a cell; the last four are full-width, as Chinese and Japanese
# keyboards type them
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
ROWS_A_PIECE = 500
Path = tuple[str, ...]
FlatFormat = Literal["csv", "ndjson"]
MOST_ROWS = 50_000
LIST_FIELDS = ("items", "groups")
FLAT_FORMATS: tuple[FlatFormat, ...] = typing.get_args(FlatFormat)
FILES = {FORMATS[output].content_type: {"schema": {"type": "string"}} for output in FLAT_FORMATS}

Endpoint = Callable[..., Any]


def safe_cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula, with an apostrophe; a list in one cell."""
    if isinstance(value, list | tuple):
        value = " ".join(map(str, value))
    if isinstance(value, str) and value.startswith(FORMULA_STARTS):
        return f"'{value}"
    return value


def flat_paths(model: type[BaseModel], rows: Iterable[Mapping[str, JsonValue]] = ()) -> list[Path]:
    """Where each column's value is in a row, from left to right.

    rows: all of them, where the model has free names.
    """
    return list(_paths(model, (), list(rows)))


def encode_flat(
    output: FlatFormat, paths: Sequence[Path], rows: Iterable[Mapping[str, JsonValue]]
) -> Iterator[bytes]:
    """Rows as JSON has them, in pieces; of no rows CSV still has its header."""
    names = ["_".join(path) for path in paths]
    left = iter(rows)
    if output == "csv":
        yield _lines([names])
    while piece := list(islice(left, ROWS_A_PIECE)):
        values = ([_at(row, path) for path in paths] for row in piece)
        if output == "csv":
            yield _lines([_cell(value) for value in row] for row in values)
        else:
            yield b"".join(to_json(dict(zip(names, row, strict=True))) + b"\n" for row in values)


def _paths(
    model: type[BaseModel], prefix: Path, rows: Sequence[Mapping[str, JsonValue]]
) -> Iterator[Path]:
    for name, field in model.model_fields.items():
        column = field.serialization_alias or name
        yield from _paths_of(
            field.annotation, (*prefix, column), [row[column] for row in rows if row.get(column)]
        )


def _paths_of(annotation: object, path: Path, values: Sequence[JsonValue]) -> Iterator[Path]:
    """Of a field. values: those that it has anywhere, which tell the names of a dict."""
    inner = _without_none(annotation)
    members = [value for value in values if isinstance(value, dict)]
    if isinstance(inner, type) and issubclass(inner, BaseModel):
        yield from _paths(inner, path, members)
    elif typing.get_origin(inner) is dict and typing.get_args(inner)[1] not in (Any, object):
        for name in dict.fromkeys(name for value in members for name in value):
            yield from _paths_of(
                typing.get_args(inner)[1], (*path, name), [v[name] for v in members if v.get(name)]
            )
    else:
        yield path


def _without_none(annotation: object) -> object:
    """X of X | None; anything else as it is."""
    if typing.get_origin(annotation) in (types.UnionType, typing.Union):
        others = [one for one in typing.get_args(annotation) if one is not type(None)]
        return others[0] if len(others) == 1 else annotation
    return annotation


def _at(row: Mapping[str, JsonValue], path: Path) -> JsonValue:
    value: JsonValue = dict(row)
    for name in path:
        value = value.get(name) if isinstance(value, dict) else None
    return value


def _cell(value: JsonValue) -> object:
    if isinstance(value, dict) or (
        isinstance(value, list) and any(isinstance(member, dict | list) for member in value)
    ):
        return safe_cell(json.dumps(value, sort_keys=True, ensure_ascii=False))
    if isinstance(value, float):
        return to_json(value).decode()  # the shortest text that reads back as the same number
    return safe_cell(value)


def _lines(rows: Iterable[Sequence[object]]) -> bytes:
    buffer = io.StringIO(newline="")
    csv.writer(buffer).writerows(rows)
    return buffer.getvalue().encode()


def negotiated_format(
    request: Request,
    output: Annotated[
        Literal["json", FlatFormat] | None,
        Query(
            alias="format",
            description="csv, ndjson: the whole list. Default: by the Accept header, else json.",
        ),
    ] = None,
) -> FlatFormat | None:
    """The file that is asked for, by the parameter or else by the header; None: JSON."""
    return asked_format(request, output, FLAT_FORMATS)


class ListRoute(APIRoute):
    """A route whose list leaves as a file too."""

    def __init__(self, path: str, endpoint: Endpoint, **options: Any) -> None:
        self._row = row_of(endpoint) if options.get("methods") in (["GET"], {"GET"}) else None
        if self._row is not None:
            name = re.sub(r"[{}]", "", path.rsplit("/", 1)[-1])
            endpoint = self._with_file(endpoint, self._row, name)
            options["responses"] = {
                200: {"content": FILES, "description": "A page, or the whole list as a file."},
                **(options.get("responses") or {}),
            }
        super().__init__(path, endpoint, **options)

    def _with_file(self, endpoint: Endpoint, row: type[BaseModel], name: str) -> Endpoint:
        """The endpoint, which answers with a file of all its pages where one is asked for."""

        @functools.wraps(endpoint)
        def paged_or_whole(
            *, file_format: FlatFormat | None, **arguments: object
        ) -> BaseModel | Response:
            if file_format is None:
                page: BaseModel = endpoint(**arguments)
                return page
            rows = _all_rows(endpoint, arguments, self._greatest_limit())
            days = (arguments.get("first_day"), arguments.get("last_day"))
            return Response(
                b"".join(encode_flat(file_format, flat_paths(row, rows), rows)),
                media_type=FORMATS[file_format].media_type,
                headers=attachment(file_format, arguments.get("study"), name, *days),
            )

        signature = inspect.signature(endpoint)
        parameter = inspect.Parameter(
            "file_format",
            inspect.Parameter.KEYWORD_ONLY,
            annotation=Annotated[FlatFormat | None, Depends(negotiated_format)],
        )
        whole = signature.replace(parameters=[*signature.parameters.values(), parameter])
        paged_or_whole.__signature__ = whole  # type: ignore[attr-defined]  # what FastAPI reads
        return paged_or_whole

    def _greatest_limit(self) -> int | None:
        """Of the endpoint's `limit`; None: the list comes whole."""
        for field in self.dependant.query_params:
            if field.alias == "limit":
                return int(next(one.le for one in field.field_info.metadata if hasattr(one, "le")))
        return None


def row_of(endpoint: Endpoint) -> type[BaseModel] | None:
    """The model of the rows that an endpoint lists; None: it lists none, or takes care of files itself."""
    hints = typing.get_type_hints(endpoint)
    answer = hints.get("return")
    if "output" in hints or not (isinstance(answer, type) and issubclass(answer, BaseModel)):
        return None
    for name in LIST_FIELDS:
        field = answer.model_fields.get(name)
        if field is not None and typing.get_origin(field.annotation) is list:
            (row,) = typing.get_args(field.annotation)
            return row if isinstance(row, type) and issubclass(row, BaseModel) else None
    return None


def _all_rows(
    endpoint: Endpoint, arguments: dict[str, object], limit: int | None
) -> list[dict[str, JsonValue]]:
    """Of all pages, as JSON has them.

    Raises InvalidInputError (`list_too_long`), and what the endpoint raises.
    """
    rows: list[dict[str, JsonValue]] = []
    paging: dict[str, object] = {} if limit is None else {"limit": limit}
    if "cursor" in arguments:
        paging["cursor"] = None
    while True:
        page = endpoint(**arguments | paging)
        listed = next(
            getattr(page, name) for name in LIST_FIELDS if name in type(page).model_fields
        )
        rows += [row.model_dump(mode="json", by_alias=True) for row in listed]
        if len(rows) > MOST_ROWS:
            raise InvalidInputError(
                f"The list has more than {MOST_ROWS:,} rows: narrow it by a filter, or follow the pages of JSON.",
                code="list_too_long",
                limit_rows=MOST_ROWS,
            )
        following = getattr(page, "next", None)
        if following is None:
            return rows
        paging["cursor"] = parse_qs(following.partition("?")[2])["cursor"][0]
