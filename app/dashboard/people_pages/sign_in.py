"""Signing in with name and password, and out. The session's token is in a cookie that scripts cannot read."""

from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Form, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.core.errors import RateLimitedError, UnauthenticatedError
from app.dashboard.templates import render
from app.http.rate_limit import caller_address
from app.people.access import sign_in
from app.people.access.deps import CurrentStaff, State
from app.people.access.page_rules import PREFIX, is_https, session_cookie
from app.people.access.passwords import Passwords
from app.people.access.sign_in_limits import SignInLimits

router = APIRouter(include_in_schema=False)

LONGEST = 1024


@router.get("/")
async def get_root() -> Response:
    """Redirect the server's root to the pages."""
    return RedirectResponse(PREFIX, status_code=307)


@router.get(f"{PREFIX}/sign-in")
def get_sign_in(next: Annotated[str, "path"] = "") -> HTMLResponse:  # noqa: A002  # the parameter's name
    """The form."""
    return HTMLResponse(render("sign_in.html", next=safe_path(next), name="", refused=None))


@router.post(f"{PREFIX}/sign-in")
def post_sign_in(
    request: Request,
    state: State,
    name: Annotated[str, Form(max_length=LONGEST)] = "",
    password: Annotated[str, Form(max_length=LONGEST)] = "",
    next: Annotated[str, Form(max_length=LONGEST)] = "",  # noqa: A002  # the field's name
) -> Response:
    """Sign in, then redirect to the requested page."""
    target = safe_path(next)
    try:
        with state.part(SignInLimits).trying(name, caller_address(request)):
            issued = sign_in.sign_in(state.database, state.part(Passwords), name, password)
    except (UnauthenticatedError, RateLimitedError) as error:
        page = render("sign_in.html", next=target, name=name, refused=error.message)
        return HTMLResponse(page, status_code=error.status)
    answer = RedirectResponse(target, status_code=303)
    is_secure = is_https(request, state.settings)
    answer.set_cookie(
        session_cookie(request, state.settings),
        issued.token,
        path="/" if is_secure else PREFIX,  # the prefix __Host- requires "/"
        secure=is_secure,
        httponly=True,
        samesite="lax",
    )
    return answer


@router.post(f"{PREFIX}/sign-out")
def post_sign_out(request: Request, state: State, caller: CurrentStaff) -> Response:
    """End the session and revoke its token."""
    sign_in.sign_out(state.database, caller)
    answer = RedirectResponse(f"{PREFIX}/sign-in", status_code=303)
    is_secure = is_https(request, state.settings)
    answer.delete_cookie(
        session_cookie(request, state.settings), path="/" if is_secure else PREFIX, secure=is_secure
    )
    answer.headers["Clear-Site-Data"] = '"cache"'
    return answer


def safe_path(path: str) -> str:
    """Return the path if it is one of the dashboard's, else the first page: a link must not lead to another site."""
    try:
        parts = urlsplit(path)
    except ValueError:  # "//[" is no valid host
        return PREFIX
    is_ours = not parts.scheme and not parts.netloc and path.isprintable() and "\\" not in path
    return (
        path
        if is_ours and (path == PREFIX or path.startswith((f"{PREFIX}/", f"{PREFIX}?")))
        else PREFIX
    )
