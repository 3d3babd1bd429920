"""How FHIR is spoken: application/fhir+json and no other; errors as OperationOutcome with the problem's own code."""

import json
import re
from collections.abc import Mapping
from typing import Any

from fastapi import Request
from fastapi.responses import JSONResponse
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import NotAcceptableError
from app.exports.fhir.names import names_of
from app.http.problems import PROBLEM_JSON

FHIR_JSON = "application/fhir+json"
JSON_FORMATS = frozenset({"json", "application/json", "text/json", FHIR_JSON})
TAKEN = JSON_FORMATS | {"*/*", "application/*"}
PREFIX = "/fhir"
FHIR_PATHS = re.compile(rf"{PREFIX}(/|$)")

# The standard's issue types (http://hl7.org/fhir/issue-type) for our statuses.
ISSUE_TYPES = {
    400: "invalid", 401: "login", 403: "forbidden", 404: "not-found", 405: "not-supported", 406: "not-supported",
    408: "timeout", 409: "conflict", 410: "deleted", 413: "too-long", 415: "not-supported", 429: "throttled",
    503: "transient",
}  # fmt: skip


class FhirJson(JSONResponse):
    """A resource. Nobody between may keep it."""

    media_type = FHIR_JSON

    def __init__(self, content: Any, status_code: int = 200, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(content, status_code, {"Cache-Control": "private, no-store", **(headers or {})})


async def require_json(request: Request) -> None:
    """Refuse who wants XML or Turtle: `_format` goes before `Accept`. Raises NotAcceptableError."""
    wanted = request.query_params.get("_format")
    if wanted is None:
        ranges = [part.strip() for part in request.headers.get("accept", "*/*").split(",")]
        is_taken = any(_is_taken(part) for part in ranges if part) or not any(ranges)
    else:
        is_taken = _is_taken(wanted.replace(" ", "+"))  # a plus sign that was not written as %2B
    if not is_taken:
        raise NotAcceptableError(f"Resources are given as {FHIR_JSON} of FHIR 5.0 only.")


def wants_strict(request: Request) -> bool:
    """Whether the caller would rather be refused than have a parameter ignored."""
    preferences = request.headers.get("prefer", "").replace(";", ",").split(",")
    return "handling=strict" in (one.strip().lower() for one in preferences)


def outcome_issue(
    severity: str, issue_type: str, code: str, system: str, text: str, expression: str | None = None
) -> dict[str, Any]:
    """An issue of an OperationOutcome. code: stable, of ours (docs/errors.md)."""
    issue: dict[str, Any] = {
        "severity": severity,
        "code": issue_type,
        "details": {"coding": [{"system": system, "code": code}], "text": text},
    }
    return issue | ({"expression": [expression]} if expression is not None else {})


class FhirErrors:
    """ASGI middleware around FHIR_PATHS: what would be a problem document leaves as an OperationOutcome.

    So also what never reaches a route: a path that is none, too many calls, a database that is away. A value that
    cannot be accepted is 400, as FHIR has it, where the rest of the API says 422.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and the answer through."""
        begun: Message | None = None
        body = b""

        async def as_outcome(message: Message) -> None:
            nonlocal begun, body
            if message["type"] == "http.response.start" and _is_problem(message):
                begun = message
            elif begun is None:
                await send(message)
            else:
                body += message.get("body", b"")
                if not message.get("more_body", False):
                    await _send_outcome(scope, begun, json.loads(body), send)

        await self._app(scope, receive, as_outcome)


async def _send_outcome(scope: Scope, begun: Message, problem: Mapping[str, Any], send: Send) -> None:
    status = 400 if problem["status"] == 422 else problem["status"]
    known = "exception" if status >= 500 else "processing"
    system = names_of(Request(scope)).system("errors")
    issue = outcome_issue("error", ISSUE_TYPES.get(status, known), problem["code"], system, problem["detail"])
    rendered = json.dumps({"resourceType": "OperationOutcome", "issue": [issue]}, ensure_ascii=False).encode()
    headers = MutableHeaders(raw=list(begun["headers"]))
    headers["content-type"], headers["content-length"] = FHIR_JSON, str(len(rendered))
    await send({**begun, "status": status, "headers": headers.raw})
    await send({"type": "http.response.body", "body": rendered})


def _is_problem(message: Message) -> bool:
    return Headers(raw=message["headers"]).get("content-type", "").startswith(PROBLEM_JSON)


def _is_taken(media_range: str) -> bool:
    name, *parameters = (part.strip().lower() for part in media_range.split(";"))
    version = next((part.partition("=")[2] for part in parameters if part.startswith("fhirversion=")), "5.0")
    return name in TAKEN and version == "5.0" and "q=0" not in parameters
