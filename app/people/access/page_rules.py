"""The dashboard's routes: each has the rule of the API call that it shows or makes, and a browser's cookie opens it.

A page may so be seen by who may make that call, and changes no more than it. What differs is how a browser calls: the
session's token stands in a cookie that scripts cannot read, a change must come from a page of ours, and what asks by
itself every few seconds does not keep a session alive.
"""

from collections.abc import Mapping
from typing import Final
from urllib.parse import urlsplit

from starlette.requests import Request

from app.core.errors import NotAllowedError
from app.core.settings import Settings

PREFIX: Final = "/dashboard"

STUDY_PAGES: Final = f"{PREFIX}/studies/{{study}}"
ELSEWHERE: Final = f"{STUDY_PAGES}/{{rest:path}}"  # what no page has
WEBHOOKS: Final = "/v1/studies/{study}/webhooks"
RELEASES: Final = "/v1/studies/{study}/releases"
VESSEL: Final = "/v1/studies/{study}/vessels/{vessel}"

Call = tuple[str, str]  # method, path

STAFF: Call = ("GET", "/v1/sessions/current")  # whoever is signed in
STUDY: Call = ("GET", "/v1/studies/{study}")  # viewers
OVERVIEW: Call = ("GET", "/v1/studies/{study}/overview")
ENROL: Call = ("POST", "/v1/studies/{study}/participants/{participant}/enrolment-codes")

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
    # overview
    ("GET", STUDY_PAGES): OVERVIEW,
    ("GET", f"{STUDY_PAGES}/overview"): OVERVIEW,
    ("GET", f"{STUDY_PAGES}/waiting"): OVERVIEW,
    # meals
    ("GET", f"{STUDY_PAGES}/meals"): ("GET", "/v1/meals"),
    ("GET", f"{STUDY_PAGES}/changed-meals"): ("GET", "/v1/studies/{study}/changed-meals"),
    # one meal
    ("GET", MEAL): ("GET", "/v1/meals/{meal_id}"),
    ("GET", f"{MEAL}/state"): ("GET", "/v1/meals/{meal_id}"),
    ("GET", f"{MEAL}/images/{{slot}}"): ("GET", "/v1/meals/{meal_id}/images/{slot}"),
    ("GET", f"{MEAL}/artefacts/{{name}}"): ("GET", "/v1/meals/{meal_id}/artefacts/{name}"),
    ("POST", f"{MEAL}/events"): ("POST", "/v1/meals/{meal_id}/events"),
    ("POST", f"{MEAL}/retry"): ("POST", "/v1/meals/{meal_id}/retry"),
    ("POST", f"{MEAL}/cancel"): ("POST", "/v1/meals/{meal_id}/cancel"),
    ("POST", f"{MEAL}/erasure"): ("DELETE", "/v1/meals/{meal_id}"),
    ("GET", f"{PREFIX}/studies/{{study}}/foods"): STUDY,
    # the review queue
    ("GET", f"{STUDY_PAGES}/review"): ("GET", "/v1/studies/{study}/review-queue"),
    ("GET", f"{STUDY_PAGES}/review/{{participant}}/{{meal_id}}"): ("GET", "/v1/studies/{study}/review-queue"),
    # participants
    ("GET", f"{STUDY_PAGES}/participants"): ("GET", "/v1/studies/{study}/participants"),
    ("POST", f"{STUDY_PAGES}/participants"): ("POST", "/v1/studies/{study}/participants"),
    ("GET", f"{STUDY_PAGES}/participants/{{participant}}"): ("GET", "/v1/studies/{study}/participants/{participant}"),
    ("POST", f"{STUDY_PAGES}/participants/{{participant}}/profile"): (
        "PATCH",
        "/v1/studies/{study}/participants/{participant}",
    ),
    ("POST", f"{STUDY_PAGES}/participants/{{participant}}/days/{{day}}"): (
        "PUT",
        "/v1/studies/{study}/participants/{participant}/days/{day}",
    ),
    ("POST", f"{STUDY_PAGES}/participants/{{participant}}/withdrawal"): (
        "POST",
        "/v1/studies/{study}/participants/{participant}/withdrawal",
    ),
    ("GET", f"{STUDY_PAGES}/intakes"): ("GET", "/v1/studies/{study}/intakes"),
    ("GET", f"{STUDY_PAGES}/adequacy"): ("GET", "/v1/studies/{study}/adequacy"),
    ("GET", f"{STUDY_PAGES}/adequacy/figures"): ("GET", "/v1/studies/{study}/adequacy"),
    ("GET", f"{STUDY_PAGES}/files/intakes"): ("GET", "/v1/studies/{study}/intakes"),
    ("GET", f"{STUDY_PAGES}/files/adequacy"): ("GET", "/v1/studies/{study}/adequacy"),
    # protocol
    ("GET", f"{STUDY_PAGES}/settings"): STUDY,
    ("POST", f"{STUDY_PAGES}/settings"): ("PATCH", "/v1/studies/{study}"),
    ("GET", f"{PREFIX}/new-study"): ("POST", "/v1/studies"),
    ("POST", f"{PREFIX}/new-study"): ("POST", "/v1/studies"),
    # people
    ("GET", f"{STUDY_PAGES}/members"): ("GET", "/v1/studies/{study}/members"),
    ("POST", f"{STUDY_PAGES}/members"): ("PUT", "/v1/studies/{study}/members/{name}"),
    ("POST", f"{STUDY_PAGES}/members/removal"): ("DELETE", "/v1/studies/{study}/members/{name}"),
    ("GET", f"{STUDY_PAGES}/devices"): ("GET", "/v1/studies/{study}/devices"),
    ("POST", f"{STUDY_PAGES}/devices/{{device_id}}/revocation"): ("DELETE", "/v1/studies/{study}/devices/{device_id}"),
    ("GET", f"{STUDY_PAGES}/enrol"): ENROL,
    ("POST", f"{STUDY_PAGES}/enrol"): ENROL,
    ("GET", f"{PREFIX}/staff"): ("GET", "/v1/staff"),
    ("POST", f"{PREFIX}/staff"): ("POST", "/v1/staff"),
    ("POST", f"{PREFIX}/staff/change"): ("PATCH", "/v1/staff/{name}"),
    ("GET", f"{PREFIX}/account"): ("GET", "/v1/tokens"),
    ("POST", f"{PREFIX}/account/password"): ("POST", "/v1/sessions/current/password"),
    ("POST", f"{PREFIX}/account/tokens"): ("POST", "/v1/tokens"),
    ("POST", f"{PREFIX}/account/tokens/{{token_id}}/revocation"): ("DELETE", "/v1/tokens/{token_id}"),
    # webhooks
    ("GET", f"{STUDY_PAGES}/webhooks"): ("GET", WEBHOOKS),
    ("POST", f"{STUDY_PAGES}/webhooks"): ("POST", WEBHOOKS),
    ("GET", f"{STUDY_PAGES}/webhooks/{{webhook}}"): ("GET", f"{WEBHOOKS}/{{webhook}}/deliveries"),
    ("POST", f"{STUDY_PAGES}/webhooks/{{webhook}}/state"): ("PATCH", f"{WEBHOOKS}/{{webhook}}"),
    ("POST", f"{STUDY_PAGES}/webhooks/{{webhook}}/secret"): ("POST", f"{WEBHOOKS}/{{webhook}}/secret"),
    ("POST", f"{STUDY_PAGES}/webhooks/{{webhook}}/test"): ("POST", f"{WEBHOOKS}/{{webhook}}/test"),
    ("POST", f"{STUDY_PAGES}/webhooks/{{webhook}}/deliveries/{{delivery}}/replay"): (
        "POST",
        f"{WEBHOOKS}/{{webhook}}/deliveries/{{delivery}}/replay",
    ),
    # foods
    ("GET", f"{PREFIX}/foods"): STAFF,
    ("GET", f"{PREFIX}/foods/{{key}}"): ("GET", "/v1/foods/{key}/changes"),
    ("GET", f"{PREFIX}/foods/{{key}}/edit"): ("PATCH", "/v1/foods/{key}"),
    ("POST", f"{PREFIX}/foods/{{key}}/edit"): ("PATCH", "/v1/foods/{key}"),
    ("GET", f"{PREFIX}/foods/{{key}}/densities"): ("POST", "/v1/foods/{key}/densities"),
    ("POST", f"{PREFIX}/foods/{{key}}/densities"): ("POST", "/v1/foods/{key}/densities"),
    ("POST", f"{PREFIX}/foods/{{key}}/restore"): ("POST", "/v1/foods/{key}/restore"),
    ("GET", f"{STUDY_PAGES}/densities"): ("GET", "/v1/studies/{study}/densities"),
    ("POST", f"{STUDY_PAGES}/densities"): ("POST", "/v1/studies/{study}/densities"),
    ("POST", f"{STUDY_PAGES}/densities/{{density}}/withdrawal"): (
        "POST",
        "/v1/studies/{study}/densities/{density}/withdrawal",
    ),
    ("GET", f"{STUDY_PAGES}/vessels"): ("GET", "/v1/studies/{study}/vessels"),
    ("POST", f"{STUDY_PAGES}/vessels"): ("POST", "/v1/studies/{study}/vessels"),
    ("GET", f"{STUDY_PAGES}/vessels/{{vessel}}"): ("GET", VESSEL),
    ("POST", f"{STUDY_PAGES}/vessels/{{vessel}}"): ("PUT", VESSEL),
    ("POST", f"{STUDY_PAGES}/vessels/{{vessel}}/retirement"): ("DELETE", VESSEL),
    ("GET", f"{PREFIX}/new-food"): ("POST", "/v1/foods"),
    ("POST", f"{PREFIX}/new-food"): ("POST", "/v1/foods"),
    # exports
    ("GET", f"{STUDY_PAGES}/exports"): ("GET", "/v1/studies/{study}/exports"),
    ("POST", f"{STUDY_PAGES}/exports"): ("POST", "/v1/studies/{study}/exports"),
    ("GET", f"{STUDY_PAGES}/exports/list"): ("GET", "/v1/studies/{study}/exports"),
    ("GET", f"{STUDY_PAGES}/exports/table"): ("GET", "/v1/studies/{study}/photographs"),
    ("GET", f"{STUDY_PAGES}/exports/dictionary"): STUDY,
    ("GET", f"{STUDY_PAGES}/exports/{{export_id}}/file"): ("GET", "/v1/studies/{study}/exports/{export_id}/file"),
    ("POST", f"{STUDY_PAGES}/exports/{{export_id}}/removal"): ("DELETE", "/v1/studies/{study}/exports/{export_id}"),
    # releases
    ("GET", f"{STUDY_PAGES}/releases"): ("GET", RELEASES),
    ("POST", f"{STUDY_PAGES}/releases"): ("POST", RELEASES),
    ("GET", f"{STUDY_PAGES}/releases-list"): ("GET", RELEASES),
    ("GET", f"{STUDY_PAGES}/releases/{{name}}"): ("GET", f"{RELEASES}/{{name}}"),
    ("GET", f"{STUDY_PAGES}/releases/{{name}}/state"): ("GET", f"{RELEASES}/{{name}}"),
    ("GET", f"{STUDY_PAGES}/releases/{{name}}/check"): ("GET", f"{RELEASES}/{{name}}/check"),
    ("GET", f"{STUDY_PAGES}/releases/{{name}}/files/{{file}}"): ("GET", f"{RELEASES}/{{name}}/files/{{file}}"),
    # audit log, marker
    ("GET", f"{STUDY_PAGES}/audit"): ("GET", "/v1/studies/{study}/audit"),
    ("GET", f"{PREFIX}/audit"): ("GET", "/v1/audit"),
    ("GET", f"{PREFIX}/marker"): STAFF,
    ("GET", f"{PREFIX}/marker.pdf"): STAFF,
    ("GET", ELSEWHERE): STUDY,
}
# asked by the page itself, again and again: no use of the session
POLLED: frozenset[Call] = frozenset(
    {
        ("GET", f"{MEAL}/state"),
        ("GET", f"{STUDY_PAGES}/changed-meals"),
        ("GET", f"{STUDY_PAGES}/waiting"),
        ("GET", f"{STUDY_PAGES}/exports/list"),
        ("GET", f"{STUDY_PAGES}/releases-list"),
        ("GET", f"{STUDY_PAGES}/releases/{{name}}/state"),
    }
)


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
