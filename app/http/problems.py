"""Errors as RFC 9457 problem documents: a stable `code`, a sentence as `detail`, and whether to try again."""

import errno
import http
from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy.exc
import structlog
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from app.core.errors import InvalidInputError, StorageFullError, TadaError, UnavailableError
from app.core.logs import bind_log_context, route_name
from app.db.session import is_disk_full

log = structlog.get_logger()

Responses = dict[int | str, dict[str, Any]]  # as FastAPI takes them
PROBLEM_JSON = "application/problem+json"
CODES_BY_STATUS = {
    400: "malformed_request",
    404: "not_found",
    405: "method_not_allowed",
    413: "too_large",
    415: "unsupported_media_type",
}
RETRY_AFTER_SECONDS = 5
CLIENT_CLOSED_REQUEST = 499  # nobody reads it; the access log does


class Problem(BaseModel):
    """RFC 9457 problem document. Further members name the limit or the place where one was passed."""

    model_config = ConfigDict(
        extra="allow",
        json_schema_extra={
            "example": {
                "type": "about:blank",
                "title": "Content Too Large",
                "status": 413,
                "detail": "The left photograph is larger than 31457280 bytes, the limit.",
                "code": "image_too_large",
                "retryable": False,
                "slot": "left",
                "limit_bytes": 31457280,
            }
        },
    )

    type: str = Field(
        default="about:blank", description="Always about:blank; `code` says what went wrong."
    )
    title: str = Field(description="The status in words.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What went wrong, in a sentence for a person.")
    code: str = Field(description="Stable: programs may rely on it.")
    retryable: bool = Field(description="Whether the same request may succeed later.")


def problem_responses(*statuses: int) -> Responses:
    """OpenAPI's `responses` for these statuses."""
    return {
        status: {
            "description": http.HTTPStatus(status).phrase,
            "content": {PROBLEM_JSON: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
        for status in statuses
    }


def value_problems(errors: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Return pydantic's errors as a problem document's `errors`: place, message and type."""
    return [
        {
            "at": ".".join(str(part) for part in error["loc"]),
            "message": error["msg"],
            "type": error["type"],
        }
        for error in errors
    ]


def install_problem_handlers(app: FastAPI) -> None:
    """Render every error of the app as a problem document."""
    app.exception_handler(TadaError)(_on_tada_error)
    app.exception_handler(RequestValidationError)(_on_invalid_request)
    app.exception_handler(HTTPException)(_on_http_exception)
    app.add_exception_handler(ClientDisconnect, _on_disconnect)
    for away in (
        sqlalchemy.exc.OperationalError,
        sqlalchemy.exc.InterfaceError,
        sqlalchemy.exc.InternalError,
        sqlalchemy.exc.TimeoutError,
    ):
        app.add_exception_handler(away, _on_database_error)
    app.add_exception_handler(sqlalchemy.exc.DataError, _on_data_error)
    app.add_exception_handler(OSError, _on_store_error)


def render_problem(error: TadaError) -> JSONResponse:
    """A TadaError as a response, with Retry-After where it makes sense."""
    headers = {}
    if error.retryable:
        headers["Retry-After"] = str(error.facts.get("retry_after_seconds", RETRY_AFTER_SECONDS))
    if error.status == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
        headers["Content-Range"] = f"bytes */{error.facts['length']}"
    if error.status == http.HTTPStatus.UNAUTHORIZED:
        headers["WWW-Authenticate"] = "Bearer"
    return _document(error.status, error.message, error.code, error.retryable, error.facts, headers)


def _document(
    status: int,
    detail: str,
    code: str,
    retryable: bool,
    facts: Mapping[str, object],
    headers: Mapping[str, str] | None,
) -> JSONResponse:
    bind_log_context(code=code)  # the request's line in the log, and its figures, have it too
    title = http.HTTPStatus(status).phrase
    problem = Problem(title=title, status=status, detail=detail, code=code, retryable=retryable)
    return JSONResponse(
        problem.model_dump() | dict(facts),
        status_code=status,
        headers=headers,
        media_type=PROBLEM_JSON,
    )


async def _on_tada_error(_: Request, error: TadaError) -> Response:
    if error.status >= http.HTTPStatus.INTERNAL_SERVER_ERROR:
        log.error("request_failed", code=error.code, detail=error.message, exc_info=error)
    return render_problem(error)


async def _on_invalid_request(_: Request, error: RequestValidationError) -> Response:
    problems = value_problems(error.errors())
    first = f"{problems[0]['at']}: {problems[0]['message']}" if problems else "invalid"
    message = f"The request has a value that cannot be accepted: {first}."
    return render_problem(InvalidInputError(message, errors=problems))


async def _on_http_exception(_: Request, error: HTTPException) -> Response:
    code = CODES_BY_STATUS.get(error.status_code, "http_error")
    return _document(error.status_code, str(error.detail), code, False, {}, error.headers)


async def _on_disconnect(_: Request, __: Exception) -> Response:
    return Response(status_code=CLIENT_CLOSED_REQUEST)


async def _on_database_error(_: Request, error: Exception) -> Response:
    log.error("database_error", exc_info=error)
    if is_disk_full(error):
        return render_problem(
            StorageFullError("The database's disk is full. Nothing was kept; try again later.")
        )
    return render_problem(
        UnavailableError("The database does not answer. Nothing was kept; try again in a moment.")
    )


async def _on_data_error(request: Request, error: Exception) -> Response:
    # its text quotes values
    log.warning(
        "value_refused_by_database", route=route_name(request.scope), error=type(error).__name__
    )
    return render_problem(
        InvalidInputError("The request holds a value that the database cannot keep.")
    )


async def _on_store_error(request: Request, error: Exception) -> Response:
    log.error("store_error", route=route_name(request.scope), exc_info=error)
    if getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT):
        return render_problem(
            StorageFullError("The server's disk is full. Nothing was kept; try again later.")
        )
    return render_problem(
        UnavailableError("The file store does not answer. Nothing was kept; try again in a moment.")
    )
