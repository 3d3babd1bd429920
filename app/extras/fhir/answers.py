"""FHIR responses: application/fhir+json only; errors as OperationOutcome with the problem's code."""

import json
import re
from collections.abc import Mapping

from fastapi import Request
from fastapi.responses import JSONResponse
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import NotAcceptableError
from app.extras.fhir.names import Resource, names_of
from app.http.answers import NOT_KEPT
from app.http.problems import PROBLEM_JSON, Problem

FHIR_JSON = "application/fhir+json"
JSON_FORMATS = frozenset({"json", "application/json", "text/json", FHIR_JSON})
ACCEPTED = JSON_FORMATS | {"*/*", "application/*"}
PREFIX = "/fhir"
FHIR_PATHS = re.compile(rf"{PREFIX}(/|$)")

# HTTP status -> the standard's issue type (http://hl7.org/fhir/issue-type)
ISSUE_TYPES = {
    400: "invalid", 401: "login", 403: "forbidden", 404: "not-found", 405: "not-supported", 406: "not-supported",
    408: "timeout", 409: "conflict", 410: "deleted", 413: "too-long", 415: "not-supported", 429: "throttled",
    503: "transient",
}  # fmt: skip


class FhirJson(JSONResponse):
    """A resource as a response."""

    media_type = FHIR_JSON

    def __init__(self, content: Resource, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(content, headers=headers)


async def require_json(request: Request) -> None:
    """Raise NotAcceptableError if the client wants XML or Turtle; `_format` has priority over `Accept`."""
    format_parameter = request.query_params.get("_format")
    if format_parameter is None:
        ranges = [part.strip() for part in request.headers.get("accept", "*/*").split(",")]
        is_accepted = any(_is_accepted(part) for part in ranges if part) or not any(ranges)
    else:
        # a plus sign that was not written as %2B
        is_accepted = _is_accepted(format_parameter.replace(" ", "+"))
    if not is_accepted:
        raise NotAcceptableError(f"Resources are available as {FHIR_JSON} of FHIR 5.0 only.")


def wants_strict(request: Request) -> bool:
    """Whether unsupported parameters are to be refused, not ignored (`Prefer: handling=strict`)."""
    preferences = request.headers.get("prefer", "").replace(";", ",").split(",")
    return "handling=strict" in (preference.strip().lower() for preference in preferences)


def outcome_issue(
    severity: str, issue_type: str, code: str, system: str, text: str, expression: str | None = None
) -> Resource:
    """Return an issue of an OperationOutcome. code: this server's stable code (docs/errors.md)."""
    issue: Resource = {
        "severity": severity,
        "code": issue_type,
        "details": {"coding": [{"system": system, "code": code}], "text": text},
    }
    return issue | ({"expression": [expression]} if expression is not None else {})


class FhirErrors:
    """ASGI middleware for FHIR_PATHS that replaces problem documents by OperationOutcomes.

    It covers errors outside of routes too: unknown paths, rate limits, an unavailable database. An
    unacceptable value is 400, as FHIR requires, while the rest of the API answers 422. By default
    nothing is kept by a browser.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the response on; replace a problem document."""
        start: Message | None = None  # of a problem document
        body = b""

        async def send_outcome(message: Message) -> None:
            nonlocal start, body
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.setdefault("X-Content-Type-Options", "nosniff")
                headers.setdefault("Cache-Control", NOT_KEPT)
                if _is_problem(message):
                    start = message
                    return
            if start is None:
                await send(message)
            else:
                body += message.get("body", b"")
                if not message.get("more_body", False):
                    await _send_outcome(scope, start, Problem.model_validate_json(body), send)

        await self._app(scope, receive, send_outcome)


async def _send_outcome(scope: Scope, start: Message, problem: Problem, send: Send) -> None:
    status = 400 if problem.status == 422 else problem.status
    default = "exception" if status >= 500 else "processing"
    system = names_of(Request(scope)).system("errors")
    issue = outcome_issue(
        "error", ISSUE_TYPES.get(status, default), problem.code, system, problem.detail
    )
    rendered = json.dumps(
        {"resourceType": "OperationOutcome", "issue": [issue]}, ensure_ascii=False
    ).encode()
    headers = MutableHeaders(raw=list(start["headers"]))
    headers["content-type"], headers["content-length"] = FHIR_JSON, str(len(rendered))
    await send({**start, "status": status, "headers": headers.raw})
    await send({"type": "http.response.body", "body": rendered})


def _is_problem(message: Message) -> bool:
    return Headers(raw=message["headers"]).get("content-type", "").startswith(PROBLEM_JSON)


def _is_accepted(media_range: str) -> bool:
    name, *parameters = (part.strip().lower() for part in media_range.split(";"))
    version = next(
        (part.partition("=")[2] for part in parameters if part.startswith("fhirversion=")), "5.0"
    )
    return name in ACCEPTED and version == "5.0" and "q=0" not in parameters
