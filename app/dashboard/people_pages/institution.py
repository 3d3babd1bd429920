"""Signing in with an account of the institution (people/access/oidc.py), and linking it.

The provider's page is opened by a page of ours, not by a redirect: browsers apply our policy for
forms to wherever a form's answer redirects, and an institution's provider may redirect further.
"""

import uuid

from fastapi import APIRouter, Request
from starlette.responses import HTMLResponse, Response

from app.dashboard.page import CurrentPage, current_page
from app.dashboard.people_pages.account import PATH, NextPath, safe_path, signed_in
from app.dashboard.templates import render
from app.http.rate_limit import caller_address
from app.http.state import ApiState
from app.people.access import oidc
from app.people.access.caller import authenticate, require_staff
from app.people.access.deps import State
from app.people.access.page_rules import (
    PREFIX,
    SESSION_COOKIE,
    own_cookie,
    set_own_cookie,
)
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import SignInLimits

router = APIRouter(include_in_schema=False)

COOKIE = "tada_flow"


@router.post(f"{PREFIX}/sign-in/institution")
def post_institution(request: Request, state: State, next_path: NextPath = "") -> Response:
    """Go to the provider to sign in."""
    return _to_provider(request, state, safe_path(next_path))


@router.post(f"{PATH}/institution")
def post_link(page: CurrentPage) -> Response:
    """Go to the provider to link the account there to the caller's."""
    return _to_provider(page.request, page.state, PATH, page.caller.token_id)


@router.post(f"{PATH}/institution/removal")
def post_unlink(page: CurrentPage) -> Response:
    """End the link."""
    oidc.link(page.database, page.caller, None)
    return page.redirect(PATH, "Your institution's account is not linked any more.")


@router.get(oidc.RETURN)
def get_return(request: Request, api: State, code: str = "", state: str = "") -> Response:
    """Come back from the provider: sign in, or link the account."""
    provider = oidc.provider_of(request, api.settings)
    box = api.part(SecretBox)
    cookie = own_cookie(request, api.settings, COOKIE)
    flow = oidc.open_flow(box, request.cookies.get(cookie, ""), state)
    if flow.links is None:
        with api.part(SignInLimits).trying(flow.state, caller_address(request)):
            identity = oidc.identify(provider, flow, code)
            issued = oidc.open_session(api.database, identity)
        return signed_in(request, api, issued, flow.next)
    cookie = own_cookie(request, api.settings, SESSION_COOKIE)
    caller = require_staff(authenticate(api.database, box, request.cookies.get(cookie, "")))
    if caller.token_id != flow.links:
        raise oidc.expired()
    oidc.link(api.database, caller, oidc.identify(provider, flow, code))
    return current_page(request, api, caller).redirect(
        PATH, "Your institution's account is linked."
    )


def _to_provider(
    request: Request, state: ApiState, next_path: str, links: uuid.UUID | None = None
) -> Response:
    provider = oidc.provider_of(request, state.settings)
    address, flow = oidc.begin(provider, next_path, links)
    page = render("institution.html", address=address, issuer=provider.issuer)
    answer = HTMLResponse(page, headers={"Refresh": f"0; url={address}"})
    sealed = state.part(SecretBox).seal(flow.model_dump_json())
    set_own_cookie(answer, request, state.settings, COOKIE, sealed, max_age=oidc.FLOW_SECONDS)
    return answer
