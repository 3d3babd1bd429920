"""Signing in and out, and the caller's own account: password, and personal tokens for scripts.

A session's token is in a cookie that scripts cannot read.
"""

import re
import uuid
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Form, Query, Request
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
from app.dashboard.page import CurrentPage, Page, drawn_qr
from app.dashboard.templates import render
from app.http.rate_limit import caller_address
from app.http.state import ApiState
from app.people.access import access_tokens, sign_in, staff, totp
from app.people.access.deps import CurrentStaff, State
from app.people.access.page_rules import (
    PREFIX,
    SESSION_COOKIE,
    set_own_cookie,
)
from app.people.access.passwords import Passwords
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import SignInLimits
from app.people.access.staff_schemas import PasswordChangeIn, SessionIssued, TokenIn
from app.people.studies import list_study_codes

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/account"

LONGEST = 1024
NextPath = Annotated[str, Query(alias="next")]  # the page to go to once signed in


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


@router.get(f"{PATH}/totp")
def get_totp(page: CurrentPage) -> Response:
    """A fresh secret to set an app up with; it is kept once a code of it was entered."""
    return _totp(page, totp.new_secret())


@router.post(f"{PATH}/totp")
def post_totp(page: CurrentPage, fields: Fields) -> Response:
    """Turn codes on."""
    values = form_values(fields)
    secret = values.get("secret", "")
    if not re.fullmatch(totp.BASE32, secret):
        return page.redirect(f"{PATH}/totp")
    try:
        code = values.get("code", "")
        totp.turn_on(page.database, page.state.part(SecretBox), page.caller, secret, code)
    except InvalidInputError as error:
        return _totp(page, secret, refused(error, name="code"))
    return page.redirect(PATH, "From now on signing in with your password needs a code.")


@router.post(f"{PATH}/totp/removal")
def post_totp_removal(page: CurrentPage, request: Request, fields: Fields) -> Response:
    """Turn codes off, by password and code."""
    values = form_values(fields)
    password, code = values.get("totp_password", ""), values.get("code", "")
    try:
        with page.state.part(SignInLimits).trying(page.caller.name, caller_address(request)):
            sign_in.check_password(
                page.database, page.state.part(Passwords), page.caller.name, password
            )
            totp.turn_off(page.database, page.state.part(SecretBox), page.caller, code)
    except (RateLimitedError, InvalidInputError) as error:
        return _account(page, refused(error, name="code"))
    except UnauthenticatedError:
        wrong = {"totp_password": "This is not your password."}
        return _account(page, FormState(wrong=wrong, status=422))
    return page.redirect(PATH, "Signing in needs no code any more.")


def _totp(page: Page, secret: str, form: FormState = EMPTY_FORM) -> Response:
    uri = totp.setup_uri(secret, name=page.caller.name, server=page.request.url.hostname or "tada")
    return page.render("totp.html", form=form, secret=secret, qr=drawn_qr(uri))


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
        me=staff.read_staff(page.database, page.caller.name),
        studies=list_study_codes(page.database, page.caller),
        tokens=access_tokens.list_tokens(page.database, page.caller),
        issued=issued,
    )


@router.get("/")
async def get_root() -> Response:
    """Redirect the server's root to the pages."""
    return RedirectResponse(PREFIX, status_code=307)


@router.get(f"{PREFIX}/sign-in")
def get_sign_in(state: State, next_path: NextPath = "") -> Response:
    """The form."""
    context = {"next": safe_path(next_path), "name": "", "proof": "", "refused": None}
    return HTMLResponse(render("sign_in.html", issuer=state.settings.oidc_issuer, **context))


@router.post(f"{PREFIX}/sign-in")
def post_sign_in(
    request: Request,
    state: State,
    name: Annotated[str, Form(max_length=LONGEST)] = "",
    password: Annotated[str, Form(max_length=LONGEST)] = "",
    next_path: Annotated[str, Form(alias="next", max_length=LONGEST)] = "",
    code: Annotated[str, Form(max_length=LONGEST)] = "",
    proof: Annotated[str, Form(max_length=LONGEST)] = "",
) -> Response:
    """Sign in, if necessary in two steps, then redirect to the requested page.

    proof: that the password was right, sealed in the page that asks for the code.
    """
    target, box, checked_hash = safe_path(next_path), state.part(SecretBox), ""
    try:
        with state.part(SignInLimits).trying(name, caller_address(request)):
            if proof:
                checked_hash = sign_in.open_proof(box, proof)
            else:
                checked_hash = sign_in.check_password(
                    state.database, state.part(Passwords), name, password
                )
            issued = sign_in.open_session(state.database, box, name, checked_hash, code)
    except (UnauthenticatedError, RateLimitedError) as error:
        if error.code == "code_needed":
            proof = box.seal(checked_hash)
        elif isinstance(error, UnauthenticatedError):
            proof = ""
        refused = error.message if code or not proof else None
        context = {"next": target, "name": name, "proof": proof, "refused": refused}
        page = render("sign_in.html", issuer=state.settings.oidc_issuer, **context)
        return HTMLResponse(page, status_code=error.status)
    return signed_in(request, state, issued, target)


def signed_in(request: Request, state: ApiState, issued: SessionIssued, target: str) -> Response:
    """Give the session to the browser, and redirect to a page."""
    answer = RedirectResponse(target, status_code=303)
    set_own_cookie(answer, request, state.settings, SESSION_COOKIE, issued.token)
    return answer


@router.post(f"{PREFIX}/sign-out")
def post_sign_out(request: Request, state: State, caller: CurrentStaff) -> Response:
    """End the session and revoke its token."""
    sign_in.sign_out(state.database, caller)
    answer = RedirectResponse(f"{PREFIX}/sign-in", status_code=303)
    set_own_cookie(answer, request, state.settings, SESSION_COOKIE, "", max_age=0)
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
