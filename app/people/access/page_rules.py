"""Access rules of the dashboard: each page has the rule of the API call that it shows or makes.

So whoever may make the call may see the page, and a page can change no more than the call. Only the
transport differs: the session's token is in a cookie that scripts cannot read, a change must come
from one of our pages, and pages that poll do not keep a session alive.
"""

from collections.abc import Mapping
from typing import Final
from urllib.parse import quote, urlsplit

from starlette.requests import Request
from starlette.responses import Response

from app.core.errors import NotAllowedError
from app.core.settings import Settings

PREFIX: Final = "/dashboard"
SESSION_COOKIE: Final = "tada_session"

STUDY_PAGES: Final = f"{PREFIX}/studies/{{study}}"
ELSEWHERE: Final = f"{STUDY_PAGES}/{{rest:path}}"  # addresses without a page

Call = tuple[str, str]  # method, path


def as_call(text: str, study: str = "") -> Call:
    """Split a call of the tables: "GET /v1/me" -> ("GET", "/v1/me"). study: replaces `~`."""
    method, path = text.replace("~", study).split(" ", 1)
    return method, path


def _pairs(table: Mapping[str, str]) -> Mapping[Call, Call]:
    return {
        as_call(page, STUDY_PAGES): as_call(call, "/v1/studies/{study}")
        for page, call in table.items()
    }


OPEN_PAGES: frozenset[Call] = frozenset(
    {
        ("GET", "/"),
        ("GET", f"{PREFIX}/sign-in"),
        ("POST", f"{PREFIX}/sign-in"),
        ("POST", f"{PREFIX}/sign-in/institution"),
        ("GET", f"{PREFIX}/sign-in/return"),
    }
)
MEAL: Final = f"{PREFIX}/studies/{{study}}/meals/{{participant}}/{{meal_id}}"
PAGES: Mapping[Call, Call] = _pairs(  # ~: the study, of the dashboard or of the API
    {
        "GET /dashboard": "GET /v1/sessions/current",
        "POST /dashboard/sign-out": "DELETE /v1/sessions/current",
        # overview
        "GET ~": "GET ~/overview",
        "GET ~/overview": "GET ~/overview",
        "GET ~/waiting": "GET ~/overview",
        # meals
        "GET ~/meals": "GET /v1/meals",
        "GET ~/changed-meals": "GET ~/changed-meals",
        # one meal
        "GET ~/meals/{participant}/{meal_id}": "GET /v1/meals/{meal_id}",
        "GET ~/meals/{participant}/{meal_id}/state": "GET /v1/meals/{meal_id}",
        "GET ~/meals/{participant}/{meal_id}/images/{slot}": "GET /v1/meals/{meal_id}/images/{slot}",
        "GET ~/meals/{participant}/{meal_id}/artefacts/{name}": "GET /v1/meals/{meal_id}/artefacts/{name}",
        "POST ~/meals/{participant}/{meal_id}/events": "POST /v1/meals/{meal_id}/events",
        "POST ~/meals/{participant}/{meal_id}/retry": "POST /v1/meals/{meal_id}/retry",
        "POST ~/meals/{participant}/{meal_id}/cancel": "POST /v1/meals/{meal_id}/cancel",
        "POST ~/meals/{participant}/{meal_id}/erasure": "DELETE /v1/meals/{meal_id}",
        "GET ~/foods": "GET ~",
        # the review queue
        "GET ~/review": "GET ~/review-queue",
        "GET ~/review/{participant}/{meal_id}": "GET ~/review-queue",
        # items that two decide: only here, with the rights of the queue
        "GET ~/blind": "GET ~/review-queue",
        "POST ~/blind": "GET ~/review-queue",
        "POST ~/blind/{decision}/undo": "GET ~/review-queue",
        "GET ~/blind/{item}/picture": "GET ~/review-queue",
        "GET ~/agreement": "GET ~/decisions",
        # participants
        "GET ~/participants": "GET ~/progress",
        "GET ~/files/progress": "GET ~/progress",
        "GET ~/flow": "GET ~/flow",
        "GET ~/files/flow": "GET ~/flow",
        "POST ~/closed-days": "PUT ~/participants/{participant}/days/{day}",
        "POST ~/participants": "POST ~/participants",
        "GET ~/participants/{participant}": "GET ~/participants/{participant}",
        "POST ~/participants/{participant}/profile": "PATCH ~/participants/{participant}",
        "POST ~/participants/{participant}/days/{day}": "PUT ~/participants/{participant}/days/{day}",
        "POST ~/participants/{participant}/withdrawal": "POST ~/participants/{participant}/withdrawal",
        "GET ~/intakes": "GET ~/intakes",
        "GET ~/adequacy": "GET ~/adequacy",
        "GET ~/adequacy/figures": "GET ~/adequacy",
        "GET ~/files/intakes": "GET ~/intakes",
        "GET ~/files/adequacy": "GET ~/adequacy",
        "GET ~/reference": "GET ~/reference-agreement",
        "POST ~/reference": "PUT ~/reference-days",
        # protocol
        "GET ~/settings": "GET ~",
        "POST ~/settings": "PATCH ~",
        "GET /dashboard/new-study": "POST /v1/studies",
        "POST /dashboard/new-study": "POST /v1/studies",
        # people
        "GET ~/members": "GET ~/members",
        "POST ~/members": "PUT ~/members/{name}",
        "POST ~/members/removal": "DELETE ~/members/{name}",
        "GET ~/devices": "GET ~/devices",
        "POST ~/devices/{device_id}/revocation": "DELETE ~/devices/{device_id}",
        "GET ~/enrol": "POST ~/participants/{participant}/enrolment-codes",
        "POST ~/enrol": "POST ~/participants/{participant}/enrolment-codes",
        "GET /dashboard/staff": "GET /v1/staff",
        "POST /dashboard/staff": "POST /v1/staff",
        "POST /dashboard/staff/change": "PATCH /v1/staff/{name}",
        "GET /dashboard/account": "GET /v1/tokens",
        "POST /dashboard/account/password": "POST /v1/sessions/current/password",
        "GET /dashboard/account/totp": "POST /v1/sessions/current/password",
        "POST /dashboard/account/totp": "POST /v1/sessions/current/password",
        "POST /dashboard/account/totp/removal": "POST /v1/sessions/current/password",
        "POST /dashboard/account/institution": "POST /v1/sessions/current/password",
        "POST /dashboard/account/institution/removal": "POST /v1/sessions/current/password",
        "POST /dashboard/account/tokens": "POST /v1/tokens",
        "POST /dashboard/account/tokens/{token_id}/revocation": "DELETE /v1/tokens/{token_id}",
        # webhooks
        "GET ~/webhooks": "GET ~/webhooks",
        "POST ~/webhooks": "POST ~/webhooks",
        "GET ~/webhooks/{webhook}": "GET ~/webhooks/{webhook}/deliveries",
        "POST ~/webhooks/{webhook}/state": "PATCH ~/webhooks/{webhook}",
        "POST ~/webhooks/{webhook}/secret": "POST ~/webhooks/{webhook}/secret",
        "POST ~/webhooks/{webhook}/test": "POST ~/webhooks/{webhook}/test",
        "POST ~/webhooks/{webhook}/deliveries/{delivery}/replay": (
            "POST ~/webhooks/{webhook}/deliveries/{delivery}/replay"
        ),
        # foods
        "GET /dashboard/foods": "GET /v1/sessions/current",
        "GET /dashboard/foods/{key}": "GET /v1/foods/{key}/changes",
        "GET /dashboard/foods/{key}/edit": "PATCH /v1/foods/{key}",
        "POST /dashboard/foods/{key}/edit": "PATCH /v1/foods/{key}",
        "GET /dashboard/foods/{key}/densities": "POST /v1/foods/{key}/densities",
        "POST /dashboard/foods/{key}/densities": "POST /v1/foods/{key}/densities",
        "POST /dashboard/foods/{key}/restore": "POST /v1/foods/{key}/restore",
        "GET ~/densities": "GET ~/densities",
        "POST ~/densities": "POST ~/densities",
        "POST ~/densities/{density}/withdrawal": "POST ~/densities/{density}/withdrawal",
        # what a study is taught counts in it alone, as its densities do
        "GET ~/taught-foods/{key}": "POST ~/densities",
        "POST ~/taught-foods/{key}": "POST ~/densities",
        "POST ~/taught-foods/{key}/photographs": "POST ~/densities",
        "POST ~/taught-foods/{key}/photographs/{photograph}/removal": "POST ~/densities",
        "GET ~/vessels": "GET ~/vessels",
        "POST ~/vessels": "POST ~/vessels",
        "GET ~/vessels/{vessel}": "GET ~/vessels/{vessel}",
        "POST ~/vessels/{vessel}": "PUT ~/vessels/{vessel}",
        "POST ~/vessels/{vessel}/retirement": "DELETE ~/vessels/{vessel}",
        "GET /dashboard/new-food": "POST /v1/foods",
        "POST /dashboard/new-food": "POST /v1/foods",
        # exports
        "GET ~/exports": "GET ~/exports",
        "POST ~/exports": "POST ~/exports",
        "GET ~/exports/list": "GET ~/exports",
        "GET ~/exports/table": "GET ~/photographs",
        "GET ~/exports/dictionary": "GET ~",
        "GET ~/exports/{export_id}/file": "GET ~/exports/{export_id}/file",
        "POST ~/exports/{export_id}/removal": "DELETE ~/exports/{export_id}",
        # releases
        "GET ~/releases": "GET ~/releases",
        "POST ~/releases": "POST ~/releases",
        "GET ~/releases-list": "GET ~/releases",
        "GET ~/releases/{name}": "GET ~/releases/{name}",
        "GET ~/releases/{name}/state": "GET ~/releases/{name}",
        "GET ~/releases/{name}/check": "GET ~/releases/{name}/check",
        "GET ~/releases/{name}/files/{file}": "GET ~/releases/{name}/files/{file}",
        # remeasurements
        "GET ~/remeasurements": "GET ~/remeasurements",
        "POST ~/remeasurements": "POST ~/remeasurements",
        "GET ~/remeasurement-plan": "GET ~/remeasurement-plan",
        "GET ~/remeasurements/{remeasurement}": "GET ~/remeasurements/{remeasurement}",
        "GET ~/remeasurements/{remeasurement}/state": "GET ~/remeasurements/{remeasurement}",
        "GET ~/remeasurements/{remeasurement}/items": "GET ~/remeasurements/{remeasurement}/items",
        "POST ~/remeasurements/{remeasurement}/stop": "POST ~/remeasurements/{remeasurement}/stop",
        "POST ~/remeasurements/{remeasurement}/continue": "POST ~/remeasurements/{remeasurement}/continue",
        # audit log, marker
        "GET ~/audit": "GET ~/audit",
        "GET /dashboard/audit": "GET /v1/audit",
        "GET /dashboard/marker": "GET /v1/sessions/current",
        "GET /dashboard/marker.pdf": "GET /v1/sessions/current",
        "GET ~/{rest:path}": "GET ~",
    }
)
# requested by scripts of the page at intervals, which does not count as use of the session
POLLED: frozenset[Call] = frozenset(
    as_call(text, STUDY_PAGES)
    for text in (
        "GET ~/meals/{participant}/{meal_id}/state",
        "GET ~/changed-meals",
        "GET ~/exports/list",
        "GET ~/releases-list",
        "GET ~/releases/{name}/state",
        "GET ~/remeasurements/{remeasurement}/state",
        "GET ~/waiting",
    )
)


def own_cookie(request: Request, settings: Settings, name: str) -> str:
    """Return a cookie's full name.

    Under HTTPS its prefix prevents that another host or plain HTTP sets it.
    """
    return f"__Host-{name}" if is_https(request, settings) else name


def set_own_cookie(
    answer: Response,
    request: Request,
    settings: Settings,
    name: str,
    value: str,
    max_age: int | None = None,
) -> None:
    """Set a cookie of ours, which scripts cannot read. max_age: seconds; None: until the browser ends."""
    is_secure = is_https(request, settings)
    answer.set_cookie(
        own_cookie(request, settings, name),
        value,
        max_age=max_age,
        path="/" if is_secure else PREFIX,  # the prefix __Host- requires "/"
        secure=is_secure,
        httponly=True,
        samesite="lax",
    )


def server_address(request: Request, settings: Settings) -> str:
    """Return the server's address as its callers reach it, without a slash at the end."""
    return settings.public_url or str(request.base_url).rstrip("/")


def is_https(request: Request, settings: Settings) -> bool:
    """Whether browsers reach the server by HTTPS."""
    return request.url.scheme == "https" or (settings.public_url or "").startswith("https://")


def require_own_page(request: Request, settings: Settings) -> None:
    """Check that one of our pages sent the request, against forgery (CSRF).

    Raises NotAllowedError (`cross_site`).

    Browsers send the origin of a request, and pages cannot change it: Sec-Fetch-Site, or Origin
    over plain HTTP. A request with neither does not come from one of our forms.
    """
    site = request.headers.get("sec-fetch-site")
    origin = request.headers.get("origin")
    if site is not None:
        is_same_origin = site == "same-origin"
    else:
        hosts = {request.headers.get("host"), urlsplit(settings.public_url or "").netloc or None}
        is_same_origin = origin is not None and urlsplit(origin).netloc in hosts - {None}
    if not is_same_origin:
        raise NotAllowedError(
            "This change did not come from a page of this server.", code="cross_site"
        )


def study_address(study: str, *parts: object) -> str:
    """Return the address of a study's page.

    parts: path segments below the study, such as "participants", "P001".
    """
    return "/".join([f"{PREFIX}/studies", *[quote(str(part), safe="") for part in (study, *parts)]])
