"""Web apps of others (CORS): which origins' pages may call the API from a browser.

Origins of TADA_WEB_ORIGINS may call with any token, a study's own ones (`web_origins`) with tokens
of its participants' phones. A preflight has no token, so it is answered for either kind;
`require_origin` then compares the call's origin with the token's study. No cookies and no `*`: the
token is a header, and the dashboard, which has a cookie, is not covered.
"""

import re
import time
import uuid
from functools import lru_cache
from urllib.parse import urlsplit

import anyio.to_thread
import sqlalchemy.exc
import structlog
from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from app.core.errors import InvalidInputError, NotAllowedError
from app.db.session import Database
from app.http.state import ApiState
from app.people import queries as people
from app.people.access.caller import Caller, DeviceCaller

log = structlog.get_logger()

WEB_PATHS = re.compile(r"^/v1/")
LOCAL_HOSTS = frozenset({"localhost", "127.0.0.1", "[::1]"})
ORIGIN = re.compile(r"(https?)://(\[::1\]|[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?)(?::([1-9][0-9]{0,4}))?")
DEFAULT_PORTS = {"https": "443", "http": "80"}
# how long origins of studies are remembered: preflights need no token and are not counted
KNOWN_SECONDS = 5.0
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
REQUEST_HEADERS = (
    "Authorization", "Content-Type", "If-Match", "If-None-Match", "If-Range", "Range", "X-App-Version", "X-Request-Id",
    "Repr-Digest", "Tus-Resumable", "Upload-Length", "Upload-Offset",
)  # fmt: skip
ANSWER_HEADERS = (
    "ETag", "Retry-After", "Location", "Date", "Content-Disposition", "Content-Range", "Accept-Ranges", "RateLimit",
    "RateLimit-Policy", "WWW-Authenticate", "X-Request-Id", "Deprecation", "Sunset",
    "Tus-Resumable", "Upload-Length", "Upload-Offset",
)  # fmt: skip


def parse_origin(text: str) -> str:
    """Return an origin as browsers write it: lower case, without its scheme's usual port.

    Raises InvalidInputError (`origin_invalid`): not scheme://host or scheme://host:port, or http
    beyond this machine.
    """
    match = ORIGIN.fullmatch(text.strip().lower())
    if match is None or int(match[3] or 0) > 65535:
        raise InvalidInputError(
            f"{text!r} is not an origin: write https://app.example.org, with a port if it has one, and without a path, "
            "a slash at the end or a *.",
            code="origin_invalid",
        )
    scheme, host, port = match.groups()
    if scheme == "http" and host not in LOCAL_HOSTS:
        raise InvalidInputError(
            f"{text!r} is not https: over plain http anybody in between could change the app. http is for localhost.",
            code="origin_invalid",
        )
    return f"{scheme}://{host}" + (f":{port}" if port not in {None, DEFAULT_PORTS[scheme]} else "")


@lru_cache(maxsize=4)
def origins_of_setting(value: str | None) -> frozenset[str]:
    """Return the origins of TADA_WEB_ORIGINS. Raises InvalidInputError (`settings_invalid`)."""
    try:
        return frozenset(parse_origin(part) for part in (value or "").split(",") if part.strip())
    except InvalidInputError as error:
        raise InvalidInputError(
            f"TADA_WEB_ORIGINS: {error.message}", code="settings_invalid"
        ) from error


class WebOrigins:
    """ASGI middleware: Starlette's CORS for the origin of each request."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._remembered: tuple[Database, float, list[tuple[uuid.UUID, list[str]]]] | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a preflight, or pass the call on and let the browser read its answer if the origin is allowed."""
        allowed = await self._allowed_origins(scope)
        cors = CORSMiddleware(
            self._app,
            allow_origins=allowed,
            allow_methods=METHODS,
            allow_headers=scope["app"].state.request_headers,
            expose_headers=ANSWER_HEADERS if allowed else (),
        )
        await cors(scope, receive, send)

    async def _allowed_origins(self, scope: Scope) -> tuple[str, ...]:
        """The request's origin if it is allowed; notes in the request's state which studies alone allow it."""
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        if (
            origin is None
            or ORIGIN.fullmatch(origin) is None
            or urlsplit(origin).netloc == headers.get("host")
        ):
            return ()  # no page, none that could be allowed (`null` too), or our own
        state: ApiState = scope["app"].state.api
        if origin in origins_of_setting(state.settings.web_origins):
            return (origin,)
        of_studies = await self._origins_of_studies(state.database)
        study_ids = frozenset(study for study, origins in of_studies if origin in origins)
        if not study_ids:
            return ()
        scope.setdefault("state", {})["origin_study_ids"] = study_ids
        return (origin,)

    async def _origins_of_studies(self, database: Database) -> list[tuple[uuid.UUID, list[str]]]:
        if self._remembered is not None:
            of_database, read_at, of_studies = self._remembered
            if of_database is database and time.monotonic() - read_at < KNOWN_SECONDS:
                return of_studies
        of_studies = await anyio.to_thread.run_sync(_read_origins, database)
        self._remembered = (database, time.monotonic(), of_studies)
        return of_studies


def require_origin(request: Request, caller: Caller) -> None:
    """Raise NotAllowedError (`origin_not_allowed`) for a page that another study than the caller's allows."""
    study_ids: frozenset[uuid.UUID] | None = getattr(request.state, "origin_study_ids", None)
    if study_ids is not None and not (
        isinstance(caller, DeviceCaller) and caller.study_id in study_ids
    ):
        raise NotAllowedError(
            "This web app is not allowed to use this token.", code="origin_not_allowed"
        )


def _read_origins(database: Database) -> list[tuple[uuid.UUID, list[str]]]:
    try:
        with database.read() as session:
            return people.web_origins(session)
    except sqlalchemy.exc.SQLAlchemyError as error:
        # the call itself reports the database
        log.warning("web_origins_unknown", error=type(error).__name__)
        return []
