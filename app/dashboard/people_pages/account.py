"""Signing in and out, and the caller's own account: password, and personal tokens for scripts.

A session's token is in a cookie that scripts cannot read.
"""

import uuid
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Form, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.core.errors import (
    ConflictError,
    InvalidInputError,
    NotFoundError,
    RateLimitedError,
    UnauthenticatedError,
)
from app.dashboard.forms import (
    EMPTY_FORM,
    Fields,
    FormState,
    WrongFormError,
    form_values,
    read_form,
    refused,
)
from app.dashboard.page import CurrentPage, Page
from app.dashboard.templates import render
from app.http.rate_limit import caller_address
from app.people.access import access_tokens, sign_in
from app.people.access.deps import CurrentStaff, State
from app.people.access.page_rules import PREFIX, is_https, session_cookie
from app.people.access.passwords import Passwords
from app.people.access.sign_in import SignInLimits
from app.people.access.staff_schemas import PasswordChangeIn, TokenIn
from app.people.studies import list_study_codes

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/account"

LONGEST = 1024


@router.get(PATH)
def get_account(page: CurrentPage) -> Response:
    """The caller's session and tokens, without their secrets."""
    return _account(page)


@router.post(f"{PATH}/password")
def post_password(page: CurrentPage, request: Request, fields: Fields) -> Response:
    """Change the password; all sessions, including this one, and all personal tokens end."""
    values = form_values(fields)
    try:
        if values.get("new_password") != values.pop("again", ""):
            raise WrongFormError({"again": "The two are not the same."})
        body = read_form(PasswordChangeIn, values)
        with page.state.part(SignInLimits).trying(page.caller.name, caller_address(request)):
            sign_in.change_own_password(
                page.database,
                page.state.part(Passwords),
                page.caller,
                current=body.current_password.get_secret_value(),
                new=body.new_password.get_secret_value(),
            )
    except RateLimitedError as error:
        return _account(page, refused(error, name="current_password"))
    except UnauthenticatedError:
        wrong = {"current_password": "This is not your password."}
        return _account(page, FormState(wrong=wrong, status=422))
    except InvalidInputError as error:
        return _account(page, refused(error, name="new_password"))
    return page.redirect(f"{PREFIX}/sign-in")


@router.post(f"{PATH}/tokens")
def post_token(page: CurrentPage, fields: Fields) -> Response:
    """Create a personal token, which is shown once."""
    values = form_values(fields)
    try:
        body = read_form(TokenIn, values)
        token, view = access_tokens.create_token(
            page.database,
            page.caller,
            name=body.name,
            scope=body.scope,
            study_code=body.study,
            days=body.days,
        )
    except (WrongFormError, ConflictError, NotFoundError) as error:
        return _account(page, refused(error, values, "name"))
    return _account(page, issued=(view.name, token))


@router.post(f"{PATH}/tokens/{{token_id}}/revocation")
def post_token_revocation(page: CurrentPage, token_id: uuid.UUID) -> Response:
    """Revoke one of the caller's own tokens."""
    access_tokens.revoke_token(page.database, page.caller, token_id)
    return page.redirect(PATH, "The token was revoked.")


def _account(
    page: Page, form: FormState = EMPTY_FORM, issued: tuple[str, str] | None = None
) -> Response:
    return page.render(
        "account.html",
        form=form,
        session=sign_in.read_session(page.database, page.caller),
        studies=list_study_codes(page.database, page.caller),
        tokens=access_tokens.list_tokens(page.database, page.caller),
        issued=issued,
    )


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
