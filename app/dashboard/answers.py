"""ASGI middleware for the dashboard: security headers on every response, and errors as HTML pages.

A middleware also covers responses that no route made, such as static files and refusals before
routing. A problem document becomes a page if the browser accepts HTML; without a session the
browser is redirected to the sign-in page.
"""

import http
import re
from collections.abc import Mapping
from urllib.parse import quote

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.dashboard.forms import sentence_of_request
from app.dashboard.templates import render
from app.http.problems import PROBLEM_JSON, Problem
from app.people.access.page_rules import PREFIX, study_address

DASHBOARD_PATHS = re.compile(rf"(?:/|{PREFIX}(?:/.*)?)$", re.DOTALL)
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "media-src 'self'; connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    # with "no-referrer" forms would send Origin: null, and be refused
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
}
NO_STORE = "private, no-store"
NOT_ACCEPTED = "This cannot be accepted"
BARE: Mapping[str, str] = {
    "not_found": "There is no such page.",
    "method_not_allowed": "This address belongs to a form: open the page that the form is on.",
}


class DashboardAnswers:
    """ASGI middleware around DASHBOARD_PATHS."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Add the headers to the response; replace a problem document by a page."""
        request_headers = Headers(scope=scope)
        held: Message | None = None  # the start of a problem document
        body = b""

        async def send_with_headers(message: Message) -> None:
            nonlocal held, body
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", NO_STORE)
                if headers.get("content-type") == PROBLEM_JSON and _wants_page(request_headers):
                    held = message
                    return
            elif held is not None:
                body += message.get("body", b"")
                if message.get("more_body"):
                    return
                problem = Problem.model_validate_json(body)
                await _page_of(scope, request_headers, held, problem)(scope, receive, send)
                return
            await send(message)

        await self._app(scope, receive, send_with_headers)


def _wants_page(headers: Headers) -> bool:
    return "text/html" in headers.get("accept", "")


def _page_of(scope: Scope, request_headers: Headers, start: Message, problem: Problem) -> Response:
    """Render a problem document as a page, or a fragment for htmx; without a session redirect to the sign-in page."""
    is_fragment = request_headers.get("hx-request") == "true"
    kept = {
        name.decode("latin-1"): value.decode("latin-1")
        for name, value in start["headers"]
        if name not in (b"content-type", b"content-length")
    }
    if problem.code == "unauthenticated" and not scope["path"].endswith("/sign-in"):
        target = _sign_in_address(scope, request_headers)
        if is_fragment:
            return Response(status_code=204, headers=kept | {"HX-Redirect": target})
        return RedirectResponse(target, status_code=303, headers=kept)
    problem = _readable_problem(problem)
    template = "problem_part.html" if is_fragment else "problem.html"
    if is_fragment:
        kept |= {"HX-Retarget": "#problem", "HX-Reswap": "innerHTML", "HX-Push-Url": "false"}
    return HTMLResponse(
        render(template, problem=problem, back=_back(scope)),
        status_code=start["status"],
        headers=kept,
    )


def _back(scope: Scope) -> tuple[str, str] | None:
    """Return (address, name) of the page's study if the caller has access to it."""
    study = scope.get("state", {}).get("study")
    return (study_address(study.code), study.name) if study is not None else None


def _readable_problem(problem: Problem) -> Problem:
    """Replace schema paths by field names, and the framework's bare titles by sentences."""
    if problem.status == http.HTTPStatus.UNPROCESSABLE_ENTITY:
        sentence = sentence_of_request((problem.model_extra or {}).get("errors", ()))
        return problem.model_copy(
            update={"title": NOT_ACCEPTED, "detail": sentence or problem.detail}
        )
    if problem.detail == problem.title:
        return problem.model_copy(update={"detail": BARE.get(problem.code, problem.detail)})
    return problem


def _sign_in_address(scope: Scope, headers: Headers) -> str:
    """Return the sign-in page's address; after signing in it returns to this page if the request was for a page."""
    if scope["method"] not in ("GET", "HEAD") or headers.get("hx-request") == "true":
        return f"{PREFIX}/sign-in"
    query = scope["query_string"].decode("latin-1")
    here = scope["path"] + (f"?{query}" if query else "")
    return (
        f"{PREFIX}/sign-in?next={quote(here, safe='')}"
        if here not in ("/", PREFIX)
        else f"{PREFIX}/sign-in"
    )
