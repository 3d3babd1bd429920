"""One's own account: the password, and personal tokens for scripts."""

import uuid

from fastapi import APIRouter, Request
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, NotFoundError, RateLimitedError, UnauthenticatedError
from app.dashboard.forms import Fields, checked, typed
from app.dashboard.page import CurrentPage, Page
from app.http.rate_limit import caller_address
from app.people.access import access_tokens, sign_in
from app.people.access.page_rules import PREFIX
from app.people.access.passwords import Passwords
from app.people.access.sign_in_limits import SignInLimits
from app.people.access.staff_schemas import PasswordChangeIn, TokenIn
from app.people.studies import known_codes

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/account"


@router.get(PATH)
def get_account(page: CurrentPage) -> Response:
    """Who is signed in, until when, as what; their tokens without the secrets."""
    return _account(page)


@router.post(f"{PATH}/password")
def post_password(page: CurrentPage, request: Request, fields: Fields) -> Response:
    """Another password; all sessions end, this one too, and all personal tokens."""
    values = typed(fields)
    if values.get("new_password") != values.pop("again", ""):
        return _account(page, wrong={"again": "The two are not the same."}, status=422)
    body, wrong = checked(PasswordChangeIn, values)
    if body is None:
        return _account(page, wrong=wrong, status=422)
    try:
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
        return _account(page, wrong={"new_password": error.message}, status=error.status)
    return page.go(f"{PREFIX}/sign-in")


@router.post(f"{PATH}/tokens")
def post_token(page: CurrentPage, fields: Fields) -> Response:
    """A personal token, shown once."""
    values = typed(fields)
    body, wrong = checked(TokenIn, values)
    if body is None:
        return _account(page, values=values, wrong=wrong, status=422)
    try:
        token, view = access_tokens.create_token(
            page.state.database, page.caller, name=body.name, scope=body.scope, study_code=body.study, days=body.days
        )
    except (ConflictError, NotFoundError) as error:
        return _account(page, values=values, wrong={"name": error.message}, status=error.status)
    return _account(page, issued=(view.name, token))


@router.post(f"{PATH}/tokens/{{token_id}}/revocation")
def post_token_revocation(page: CurrentPage, token_id: uuid.UUID) -> Response:
    """End one of one's own tokens."""
    access_tokens.revoke_token(page.state.database, page.caller, token_id)
    return page.go(PATH, "The token opens nothing any more.")


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
        studies=known_codes(page.state.database, page.caller),
        tokens=access_tokens.list_tokens(page.state.database, page.caller),
        values=values or {},
        wrong=wrong or {},
        issued=issued,
    )
