"""The dashboard's routes: each has the rule of the API call that it shows or makes, and a browser's cookie opens it.

A page may so be seen by who may make that call, and changes no more than it. What differs is how a browser calls: the
session's token stands in a cookie that scripts cannot read, a change must come from a page of ours, and what asks by
itself every few seconds does not keep a session alive.
"""

from collections.abc import Mapping
from typing import Final
from urllib.parse import urlsplit

from starlette.requests import Request

from app.errors import NotAllowedError
from app.settings import Settings

PREFIX: Final = "/dashboard"

Call = tuple[str, str]  # method, path

STAFF: Call = ("GET", "/v1/sessions/current")  # whoever is signed in
STUDY: Call = ("GET", "/v1/studies/{study}")  # viewers

OPEN_PAGES: frozenset[Call] = frozenset(
    {
        ("GET", "/"),
        ("GET", f"{PREFIX}/sign-in"),
        ("POST", f"{PREFIX}/sign-in"),
    }
)
MEAL: Final = f"{PREFIX}/studies/{{study}}/meals/{{participant}}/{{meal_id}}"
PAGES: Mapping[Call, Call] = {
    ("GET", PREFIX): STAFF,
    ("POST", f"{PREFIX}/sign-out"): ("DELETE", "/v1/sessions/current"),
    # one meal
    ("POST", f"{MEAL}/events"): ("POST", "/v1/meals/{meal_id}/events"),
    ("GET", f"{PREFIX}/studies/{{study}}/foods"): STUDY,
}
# asked by the page itself, again and again: no use of the session
POLLED: frozenset[Call] = frozenset()


def session_cookie(request: Request, settings: Settings) -> str:
    """The cookie's name. Under HTTPS the prefix keeps it from being set by another host or over plain HTTP."""
    return "__Host-tada_session" if is_https(request, settings) else "tada_session"


def is_https(request: Request, settings: Settings) -> bool:
    """Whether browsers reach us by HTTPS."""
    return request.url.scheme == "https" or (settings.public_url or "").startswith("https://")


def require_own_page(request: Request, settings: Settings) -> None:
    """Let through what a page of ours sent. Raises NotAllowedError (`cross_site`): another site makes the browser call.

    Browsers tell where a request comes from, and no page can make them tell otherwise: Sec-Fetch-Site, or Origin where
    that is not sent (plain HTTP). A request with neither is no form of ours.
    """
    site = request.headers.get("sec-fetch-site")
    origin = request.headers.get("origin")
    if site is not None:
        is_ours = site == "same-origin"
    else:
        hosts = {request.headers.get("host"), urlsplit(settings.public_url or "").netloc or None}
        is_ours = origin is not None and urlsplit(origin).netloc in hosts - {None}
    if not is_ours:
        raise NotAllowedError("This change did not come from a page of this server.", code="cross_site")
