"""The caller's own account: password, and personal tokens for scripts."""

import uuid

from fastapi import APIRouter, Request
from starlette.responses import Response

from app.core.errors import (
    ConflictError,
    InvalidInputError,
    NotFoundError,
    RateLimitedError,
    UnauthenticatedError,
)
from app.dashboard.forms import Fields, WrongFormError, form_values, read_form, wrong_fields
from app.dashboard.page import CurrentPage, Page
from app.http.rate_limit import caller_address
from app.people.access import access_tokens, sign_in
from app.people.access.page_rules import PREFIX
from app.people.access.passwords import Passwords
from app.people.access.sign_in_limits import SignInLimits
from app.people.access.staff_schemas import PasswordChangeIn, TokenIn
from app.people.studies import list_study_codes

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/account"


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
                page.state.database,
                page.state.part(Passwords),
                page.caller,
                current=body.current_password.get_secret_value(),
                new=body.new_password.get_secret_value(),
            )
    except RateLimitedError as error:
        return _account(page, wrong={"current_password": error.message}, status=error.status)
    except UnauthenticatedError:
        return _account(page, wrong={"current_password": "This is not your password."}, status=422)
    except InvalidInputError as error:
        return _account(page, wrong=wrong_fields(error, "new_password"), status=error.status)
    return page.redirect(f"{PREFIX}/sign-in")


@router.post(f"{PATH}/tokens")
def post_token(page: CurrentPage, fields: Fields) -> Response:
    """Create a personal token, which is shown once."""
    values = form_values(fields)
    try:
        body = read_form(TokenIn, values)
        token, view = access_tokens.create_token(
            page.state.database,
            page.caller,
            name=body.name,
            scope=body.scope,
            study_code=body.study,
            days=body.days,
        )
    except (WrongFormError, ConflictError, NotFoundError) as error:
        return _account(page, values=values, wrong=wrong_fields(error, "name"), status=error.status)
    return _account(page, issued=(view.name, token))


@router.post(f"{PATH}/tokens/{{token_id}}/revocation")
def post_token_revocation(page: CurrentPage, token_id: uuid.UUID) -> Response:
    """Revoke one of the caller's own tokens."""
    access_tokens.revoke_token(page.state.database, page.caller, token_id)
    return page.redirect(PATH, "The token was revoked.")


def _account(
    page: Page,
    *,
    values: dict[str, str] | None = None,
    wrong: dict[str, str] | None = None,
    issued: tuple[str, str] | None = None,
    status: int = 200,
) -> Response:
    return page.render(
        "account.html",
        status=status,
        session=sign_in.read_session(page.state.database, page.caller),
        studies=list_study_codes(page.state.database, page.caller),
        tokens=access_tokens.list_tokens(page.state.database, page.caller),
        values=values or {},
        wrong=wrong or {},
        issued=issued,
    )
