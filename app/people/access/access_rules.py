"""Who may call which route: one table, denied by default.

Calls of a route without a rule are refused.

A rule names who may call: anyone, a participant's phone, staff with at least a role in the study
concerned, or admins. `authorise` runs before every route: it finds the rule and the caller and, if
the path names a study, checks that the caller may enter it. If the study follows from something
else, such as a meal, the use case calls `require_study`, which checks the role that the rule
requires. An app has the rules of its extras as well (app/main.py); docs/access.md is generated from
all of them.
"""

import uuid
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args, get_origin

from fastapi import Depends, Request, Security
from fastapi.dependencies.utils import get_flat_params
from fastapi.params import Query
from fastapi.routing import APIRoute
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from app.core.errors import InvalidInputError, NotAllowedError, NotFoundError, UnauthenticatedError
from app.http.rate_limit import CallLimits, call_class
from app.http.state import ApiState
from app.metrics.server import may_read
from app.people.access import page_rules as pages
from app.people.access.caller import (
    Caller,
    DeviceCaller,
    StaffCaller,
    authenticate,
    require_device,
    require_staff,
)
from app.people.access.last_use import LastUse
from app.people.access.secret_box import SecretBox
from app.people.access.web_origins import require_origin
from app.people.studies import enter_study
from app.people.tombstones import meal_id_of, require_not_deleted

SAFE_METHODS = frozenset({"GET", "HEAD"})
OF_API = "/v1/"

bearer = HTTPBearer(
    auto_error=False, description="A device's token (POST /v1/enrolments) or a staff member's."
)


@dataclass(frozen=True, slots=True)
class Rule:
    """Who may call a route.

    staff: the least role in the study; "any": all staff; None: no staff. Admins may call whatever
    staff may call. session: staff must have signed in with a password; a personal token is not
    enough. scraper: only readers of metrics (app/metrics/server.py). page: called by a browser with
    the session in a cookie (people/access/page_rules.py).
    """

    is_open: bool = False
    device: bool = False
    staff: Literal["any", "viewer", "reviewer", "owner", "admin"] | None = None
    session: bool = False
    scraper: bool = False
    page: bool = False


OPEN = Rule(is_open=True)
DEVICE = Rule(device=True)
ANY = Rule(device=True, staff="any")
STAFF = Rule(staff="any")
SESSION = Rule(staff="any", session=True)
VIEWER = Rule(staff="viewer")
VIEWER_OR_DEVICE = Rule(device=True, staff="viewer")
REVIEWER = Rule(staff="reviewer")
REVIEWER_OR_DEVICE = Rule(device=True, staff="reviewer")
OWNER = Rule(staff="owner")
OWNER_OR_DEVICE = Rule(device=True, staff="owner")
ADMIN = Rule(staff="admin")
SCRAPER = Rule(scraper=True)

CALLS: Mapping[str, Rule] = {
    # health
    "GET /healthz": OPEN,
    "HEAD /healthz": OPEN,
    "GET /readyz": OPEN,
    "HEAD /readyz": OPEN,
    "GET /metrics": SCRAPER,
    "GET /v1/server": OPEN,
    # people
    "POST /v1/enrolments": OPEN,
    "GET /v1/me": DEVICE,
    "DELETE /v1/me/device": DEVICE,
    "POST /v1/sessions": OPEN,
    "GET /v1/sessions/current": SESSION,
    "DELETE /v1/sessions/current": SESSION,
    "POST /v1/sessions/current/password": SESSION,
    "GET /v1/tokens": SESSION,
    "POST /v1/tokens": SESSION,
    "DELETE /v1/tokens/{token_id}": SESSION,
    "GET /v1/staff": ADMIN,
    "POST /v1/staff": ADMIN,
    "GET /v1/staff/{name}": ADMIN,
    "PATCH /v1/staff/{name}": ADMIN,
    "GET /v1/studies": STAFF,
    "POST /v1/studies": ADMIN,
    "GET /v1/studies/{study}": VIEWER,
    "PATCH /v1/studies/{study}": OWNER,
    "GET /v1/studies/{study}/members": OWNER,
    "PUT /v1/studies/{study}/members/{name}": OWNER,
    "DELETE /v1/studies/{study}/members/{name}": OWNER,
    "GET /v1/studies/{study}/devices": VIEWER,
    "DELETE /v1/studies/{study}/devices/{device_id}": OWNER,
    "GET /v1/studies/{study}/participants": VIEWER,
    "POST /v1/studies/{study}/participants": OWNER,
    "GET /v1/studies/{study}/participants/{participant}": VIEWER,
    "PATCH /v1/studies/{study}/participants/{participant}": OWNER,
    "POST /v1/studies/{study}/participants/{participant}/enrolment-codes": OWNER,
    # meals and records
    "POST /v1/meals": DEVICE,
    "PUT /v1/meals/{meal_id}": DEVICE,
    "PUT /v1/meals/{meal_id}/images/{slot}": DEVICE,
    "POST /v1/meals/{meal_id}/images/{slot}/upload": DEVICE,
    "GET /v1/meals/{meal_id}/images/{slot}/upload": DEVICE,
    "PATCH /v1/meals/{meal_id}/images/{slot}/upload": DEVICE,
    "DELETE /v1/meals/{meal_id}/images/{slot}/upload": DEVICE,
    "PUT /v1/meals/{meal_id}/after": DEVICE,
    "GET /v1/meals": VIEWER_OR_DEVICE,
    "GET /v1/studies/{study}/meal-counts": VIEWER,
    "GET /v1/studies/{study}/changed-meals": VIEWER,
    "GET /v1/meals/{meal_id}": VIEWER_OR_DEVICE,
    "GET /v1/meals/{meal_id}/artefacts/{name}": VIEWER_OR_DEVICE,
    "GET /v1/meals/{meal_id}/images/{slot}": VIEWER_OR_DEVICE,
    "POST /v1/meals/{meal_id}/cancel": REVIEWER_OR_DEVICE,
    "POST /v1/meals/{meal_id}/retry": REVIEWER,
    "GET /v1/records": VIEWER_OR_DEVICE,
    "GET /v1/data-dictionary": VIEWER_OR_DEVICE,
    "GET /v1/studies/{study}/photographs": VIEWER,
    "GET /v1/studies/{study}/changes": VIEWER,
    # days and feedback
    "GET /v1/me/days": DEVICE,
    "PUT /v1/me/days/{day}": DEVICE,
    "GET /v1/me/summary": DEVICE,
    "GET /v1/days": VIEWER_OR_DEVICE,
    "GET /v1/studies/{study}/participants/{participant}/days": VIEWER,
    "PUT /v1/studies/{study}/participants/{participant}/days/{day}": REVIEWER,
    "GET /v1/studies/{study}/participants/{participant}/summary": VIEWER,
    "GET /v1/studies/{study}/intakes": VIEWER,
    "GET /v1/studies/{study}/adequacy": VIEWER,
    "GET /v1/studies/{study}/overview": VIEWER,
    "PUT /v1/studies/{study}/reference-days": OWNER,
    "GET /v1/studies/{study}/reference-agreement": VIEWER,
    "GET /v1/studies/{study}/progress": VIEWER,
    "GET /v1/studies/{study}/flow": VIEWER,
    # before a meal: checks and the phone's camera
    "POST /v1/checks": DEVICE,
    "POST /v1/calibrations": DEVICE,
    "GET /v1/calibrations": DEVICE,
    "POST /v1/calibrations/{calibration_id}/withdrawal": OWNER_OR_DEVICE,
    "GET /v1/studies/{study}/calibrations": VIEWER,
    "POST /v1/rigs": DEVICE,
    "POST /v1/studies/{study}/rigs": OWNER,
    # the study's vessels
    "GET /v1/me/vessels": DEVICE,
    "GET /v1/studies/{study}/vessels": VIEWER,
    "POST /v1/studies/{study}/vessels": OWNER,
    "GET /v1/studies/{study}/vessels/{vessel}": VIEWER,
    "PUT /v1/studies/{study}/vessels/{vessel}": OWNER,
    "DELETE /v1/studies/{study}/vessels/{vessel}": OWNER,
    # review
    "POST /v1/meals/{meal_id}/events": REVIEWER_OR_DEVICE,
    "GET /v1/meals/{meal_id}/events": VIEWER_OR_DEVICE,
    "GET /v1/studies/{study}/review-queue": REVIEWER,
    "GET /v1/studies/{study}/decisions": VIEWER,
    "PUT /v1/studies/{study}/known-items/{item}": OWNER,
    "GET /v1/me/questions": DEVICE,
    "POST /v1/declared-meals": DEVICE,
    "GET /v1/me/favourites": DEVICE,
    "PUT /v1/me/favourites": DEVICE,
    # webhooks
    "GET /v1/studies/{study}/webhooks": OWNER,
    "POST /v1/studies/{study}/webhooks": OWNER,
    "GET /v1/studies/{study}/webhooks/{webhook}": OWNER,
    "PATCH /v1/studies/{study}/webhooks/{webhook}": OWNER,
    "DELETE /v1/studies/{study}/webhooks/{webhook}": OWNER,
    "POST /v1/studies/{study}/webhooks/{webhook}/secret": OWNER,
    "POST /v1/studies/{study}/webhooks/{webhook}/test": OWNER,
    "GET /v1/studies/{study}/webhooks/{webhook}/deliveries": OWNER,
    "POST /v1/studies/{study}/webhooks/{webhook}/deliveries/{delivery}/replay": OWNER,
    # files made in the background
    "GET /v1/studies/{study}/exports": VIEWER,
    "POST /v1/studies/{study}/exports": VIEWER,
    "GET /v1/studies/{study}/exports/{export_id}": VIEWER,
    "GET /v1/studies/{study}/exports/{export_id}/file": VIEWER,
    "DELETE /v1/studies/{study}/exports/{export_id}": VIEWER,
    "GET /v1/studies/{study}/releases": VIEWER,
    "POST /v1/studies/{study}/releases": OWNER,
    "GET /v1/studies/{study}/releases/{name}": VIEWER,
    "GET /v1/studies/{study}/releases/{name}/check": VIEWER,
    "GET /v1/studies/{study}/releases/{name}/files/{file}": VIEWER,
    # measuring again
    "GET /v1/studies/{study}/remeasurement-plan": OWNER,
    "GET /v1/studies/{study}/remeasurements": VIEWER,
    "POST /v1/studies/{study}/remeasurements": OWNER,
    "GET /v1/studies/{study}/remeasurements/{remeasurement}": VIEWER,
    "GET /v1/studies/{study}/remeasurements/{remeasurement}/items": VIEWER,
    "POST /v1/studies/{study}/remeasurements/{remeasurement}/stop": OWNER,
    "POST /v1/studies/{study}/remeasurements/{remeasurement}/continue": OWNER,
    # privacy
    "DELETE /v1/meals/{meal_id}": OWNER_OR_DEVICE,
    "POST /v1/me/withdrawal": DEVICE,
    "POST /v1/studies/{study}/participants/{participant}/withdrawal": OWNER,
    "GET /v1/me/export": DEVICE,
    "GET /v1/receipts/{receipt}": OPEN,
    "GET /v1/studies/{study}/audit": OWNER,
    "GET /v1/audit": ADMIN,
    # foods
    "GET /v1/foods": ANY,
    "GET /v1/foods/{key}": ANY,
    "GET /v1/food-groups": ANY,
    "GET /v1/packaged-foods/{barcode}": ANY,
    "POST /v1/barcodes": DEVICE,
    "GET /v1/reference-intakes": ANY,
    "POST /v1/foods": ADMIN,
    "PATCH /v1/foods/{key}": ADMIN,
    "POST /v1/foods/{key}/densities": ADMIN,
    "POST /v1/foods/{key}/restore": ADMIN,
    "GET /v1/foods/{key}/changes": STAFF,
    "GET /v1/studies/{study}/densities": VIEWER,
    "POST /v1/studies/{study}/densities": OWNER,
    "POST /v1/studies/{study}/densities/{density}/withdrawal": OWNER,
}


def rules_of(calls: Mapping[str, Rule]) -> dict[tuple[str, str], Rule]:
    """Return a table's rules by (method, path)."""
    return {pages.as_call(call): rule for call, rule in calls.items()}


# those of an app, with its extras', are in app.state.rules (app/main.py)
RULES: Mapping[tuple[str, str], Rule] = {
    **rules_of(CALLS),
    **dict.fromkeys(pages.OPEN_PAGES, Rule(is_open=True, page=True)),
    **{
        page: replace(CALLS[" ".join(call)], device=False, session=True, page=True)
        for page, call in pages.PAGES.items()
    },
}


async def api_state(request: Request) -> ApiState:
    """Return the process's state."""
    state: ApiState = request.app.state.api
    return state


def authorise(
    request: Request,
    state: Annotated[ApiState, Depends(api_state)],
    credentials: Annotated[HTTPAuthorizationCredentials | None, Security(bearer)],
) -> Caller | None:
    """Return the caller if the route's rule allows the call; None if the route is open.

    Raises UnauthenticatedError, GoneError (`withdrawn`; `meal_deleted` for a change of a deleted
    meal), RateLimitedError, NotAllowedError, NotFoundError (a study in which they have no role),
    InvalidInputError (`parameter_unknown`, `parameter_repeated`).
    """
    call = request.method, request.scope["route"].path
    rule: Rule | None = request.app.state.rules.get(call)
    if rule is None:
        raise NotAllowedError(
            "This call is refused, because it has no access rule.", code="no_rule"
        )
    if rule.page and request.method not in SAFE_METHODS:
        pages.require_own_page(request, state.settings)
    caller = None
    if rule.scraper:
        _require_scraper(request, state)
    elif not rule.is_open:
        caller = authenticate(
            state.database, state.part(SecretBox), _token(request, state, rule, credentials)
        )
        _count(request, state, caller)
        if call not in pages.POLLED:
            state.part(LastUse).note(caller, request.headers)
        require_origin(request, caller)
        caller = _apply(rule, caller, request.method)
        if request.method not in SAFE_METHODS and "meal_id" in request.path_params:
            _refuse_deleted_meal(state, caller, request.path_params["meal_id"])
        if "study" in request.path_params:
            with state.database.read() as session:
                request.state.study = enter_study(session, caller, request.path_params["study"])
        request.state.caller = caller
    if request.query_params and call[1].startswith(OF_API):
        _require_known_parameters(request)
    return caller


# async, since they do not block: FastAPI would run each of them in a thread otherwise
async def current_caller(caller: Annotated[Caller | None, Depends(authorise)]) -> Caller:
    """Return the caller. Raises UnauthenticatedError."""
    if caller is None:
        raise UnauthenticatedError("Send the header `Authorization: Bearer TOKEN`.")
    return caller


async def current_device(caller: Annotated[Caller, Depends(current_caller)]) -> DeviceCaller:
    """Return the calling phone. Raises NotAllowedError for staff."""
    return require_device(caller)


async def current_staff(caller: Annotated[Caller, Depends(current_caller)]) -> StaffCaller:
    """Return the calling staff member. Raises NotAllowedError for a phone."""
    return require_staff(caller)


def _refuse_deleted_meal(state: ApiState, caller: Caller, client_id: str) -> None:
    """Refuse a change of a deleted meal before its body is read.

    Reads are answered later (privacy/me_api.py).
    """
    if not isinstance(caller, DeviceCaller):
        return
    try:
        meal_id = meal_id_of(caller.participant_id, uuid.UUID(client_id))
    except ValueError:
        return  # not a UUID: the route reports it
    with state.database.read() as session:
        require_not_deleted(session, state.part(SecretBox), meal_id)


def _token(
    request: Request, state: ApiState, rule: Rule, credentials: HTTPAuthorizationCredentials | None
) -> str:
    """Return the token: of a page from the cookie only, of an API call from the header only."""
    if rule.page:
        token = request.cookies.get(pages.own_cookie(request, state.settings, pages.SESSION_COOKIE))
        if token is None:
            raise UnauthenticatedError("Sign in first.")
        return token
    if credentials is None:
        raise UnauthenticatedError("Send the header `Authorization: Bearer TOKEN`.")
    return credentials.credentials


def _require_scraper(request: Request, state: ApiState) -> None:
    token = state.settings.metrics_token
    address = request.client.host if request.client is not None else None
    match may_read(
        token.get_secret_value() if token is not None else None, address, request.headers
    ):
        case "wrong token":
            raise UnauthenticatedError(
                "Send the header `Authorization: Bearer` with what TADA_METRICS_TOKEN is."
            )
        case "hidden":
            raise NotFoundError("Not Found")


def _count(request: Request, state: ApiState, caller: Caller) -> None:
    """Count the call and keep the remaining quota for the response's headers."""
    call = call_class(request.scope)
    if call is None:
        return
    is_device = isinstance(caller, DeviceCaller)
    key = caller.device_id if isinstance(caller, DeviceCaller) else caller.staff_id
    quota = state.part(CallLimits).count("device" if is_device else "staff", str(key), call)
    if quota is not None:
        request.state.rate_limit_headers = quota.headers(call)


def _apply(rule: Rule, caller: Caller, method: str) -> Caller:
    """Return the caller with the role that the rule requires.

    Raises NotAllowedError if the rule refuses them.
    """
    if isinstance(caller, DeviceCaller):
        if not rule.device:
            code = "admin_only" if rule.staff == "admin" else "staff_only"
            raise NotAllowedError(
                "A participant's device cannot do this: use a staff member's token.", code=code
            )
        return caller
    if rule.staff is None:
        raise NotAllowedError(
            "Only a participant's device can do this: use a device token.", code="device_only"
        )
    if rule.staff == "admin" and not caller.is_admin:
        raise NotAllowedError("Only an admin can do this.", code="admin_only")
    if rule.session and caller.kind != "session":
        raise NotAllowedError(
            "Sign in with your password for this (POST /v1/sessions).", code="session_needed"
        )
    if method not in SAFE_METHODS and not caller.can_write:
        raise NotAllowedError("This token may read only.", code="token_read_only")
    return (
        replace(caller, needs=rule.staff)
        if rule.staff in ("viewer", "reviewer", "owner")
        else caller
    )


def _require_known_parameters(request: Request) -> None:
    """Refuse unknown query parameters and second values of single ones: an ignored filter would return other rows.

    Other addresses have rules of their own for these; pages of the dashboard have forms.
    """
    takes_list = list_parameters(request.scope["route"])
    unknown = sorted(request.query_params.keys() - takes_list.keys())
    if unknown:
        names = ", ".join(sorted(takes_list)) or "none"
        raise InvalidInputError(
            f"There is no parameter {', '.join(unknown)[:200]!r} here. There is: {names}.",
            code="parameter_unknown",
            parameters=unknown,
        )
    counts = Counter(name for name, _ in request.query_params.multi_items())
    repeated = sorted(name for name, count in counts.items() if count > 1 and not takes_list[name])
    if repeated:
        raise InvalidInputError(
            f"Give each of these parameters once: {', '.join(repeated)[:200]}.",
            code="parameter_repeated",
            parameters=repeated,
        )


def list_parameters(route: APIRoute) -> dict[str, bool]:
    """Return the route's declared query parameters, each with whether it takes a list."""
    return {
        field.alias: any(get_origin(each) is list for each in (annotation, *get_args(annotation)))
        for field in get_flat_params(route.dependant)
        if isinstance(field.field_info, Query)
        for annotation in (field.field_info.annotation,)
    }
