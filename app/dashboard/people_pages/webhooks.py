"""A study's webhooks: which program is told of what, and what came of telling it."""

import uuid
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError
from app.dashboard.addresses import study_address
from app.dashboard.forms import Fields, checked, take_version, typed
from app.dashboard.page import CurrentPage, Page
from app.http.paging import Cursor
from app.outbox.models import ALL_EVENTS, EVENTS
from app.people.access.page_rules import PREFIX
from app.people.access.secret_box import SecretBox
from app.webhooks.schemas import WebhookIn
from app.webhooks.webhooks import IssuedSecret, Webhooks

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/studies/{{study}}/webhooks"
DELIVERIES_A_PAGE = 50

DeliveryState = Annotated[Literal["waiting", "delivered", "given_up", ""], Query()]


@router.get(PATH)
def get_webhooks(page: CurrentPage, study: str) -> Response:
    """All of them, disabled ones too."""
    return _webhooks(page, study)


@router.post(PATH)
def post_webhook(page: CurrentPage, study: str, fields: Fields) -> Response:
    """A new one; its secret is shown here and never again."""
    values = {"url": typed(fields).get("url", ""), "events": fields.getlist("events")}
    body, wrong = checked(WebhookIn, values)
    if body is None:
        return _webhooks(page, study, url=str(values["url"]), wrong=wrong, status=422)
    try:
        issued = _use_case(page, study).create(body.url, body.events)
    except (InvalidInputError, ConflictError) as error:
        return _webhooks(page, study, url=body.url, wrong={"url": error.message}, status=error.status)
    return _webhooks(page, study, issued=issued)


@router.get(f"{PATH}/{{webhook}}")
def get_webhook(
    page: CurrentPage, study: str, webhook: uuid.UUID, state: DeliveryState = "", cursor: Cursor = None
) -> Response:
    """One of them, and the log of its deliveries, the newest first."""
    hooks = _use_case(page, study)
    hook = hooks.read(webhook)
    found = hooks.list_deliveries(webhook, state=state or None, cursor=cursor, limit=DELIVERIES_A_PAGE)
    return page.render("webhook.html", hook=hook, rows=found.rows, next=found.cursor, state=state)


@router.post(f"{PATH}/{{webhook}}/state")
def post_state(page: CurrentPage, study: str, webhook: uuid.UUID, fields: Fields) -> Response:
    """Disable: what waits is given up; or enable again, as it was when the page was opened."""
    values = typed(fields)
    if values.get("is_enabled") != "true":
        _use_case(page, study).disable(webhook)
        return page.go(study_address(study, "webhooks", webhook), "Nothing more is sent to it.")
    _use_case(page, study).change(
        webhook,
        expected=take_version(values),
        is_enabled=True,
    )
    return page.go(study_address(study, "webhooks", webhook), "It is told again from now on.")


@router.post(f"{PATH}/{{webhook}}/secret")
def post_secret(page: CurrentPage, study: str, webhook: uuid.UUID) -> Response:
    """A fresh secret, shown once; for a day deliveries are signed by the old one too."""
    return _webhooks(page, study, issued=_use_case(page, study).rotate_secret(webhook))


@router.post(f"{PATH}/{{webhook}}/test")
def post_test(page: CurrentPage, study: str, webhook: uuid.UUID) -> Response:
    """Send a ping."""
    _use_case(page, study).test(webhook)
    return page.go(study_address(study, "webhooks", webhook), "A ping is on its way; its delivery stands in the log.")


@router.post(f"{PATH}/{{webhook}}/deliveries/{{delivery}}/replay")
def post_replay(page: CurrentPage, study: str, webhook: uuid.UUID, delivery: uuid.UUID) -> Response:
    """Send a payload once more, as it was then."""
    _use_case(page, study).replay(webhook, delivery)
    return page.go(study_address(study, "webhooks", webhook), "It is sent once more, as a new delivery.")


def _use_case(page: Page, study: str) -> Webhooks:
    state = page.state
    allow_loopback = state.settings.webhook_allow_loopback
    return Webhooks(state.database, state.part(SecretBox), allow_loopback, page.caller, study)


def _webhooks(
    page: Page,
    study: str,
    *,
    url: str = "",
    wrong: dict[str, str] | None = None,
    issued: IssuedSecret | None = None,
    status: int = 200,
) -> Response:
    return page.render(
        "webhooks.html",
        status=status,
        rows=_use_case(page, study).list(),
        events=(ALL_EVENTS, *EVENTS),
        url=url,
        wrong=wrong or {},
        issued=issued,
    )
