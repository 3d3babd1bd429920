"""A study's webhooks: subscriptions to events, and the log of their deliveries."""

import uuid
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError
from app.dashboard.forms import (
    EMPTY_FORM,
    Fields,
    FormState,
    form_values,
    read_form,
    refused,
    take_version,
)
from app.dashboard.page import CurrentPage, Page
from app.http.paging import Cursor
from app.outbox.models import ALL_EVENTS, EVENTS
from app.people.access.page_rules import PREFIX, study_address
from app.people.access.secret_box import SecretBox
from app.webhooks.schemas import WebhookIn
from app.webhooks.webhooks import IssuedSecret, Webhooks

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/studies/{{study}}/webhooks"
DELIVERIES_A_PAGE = 50

DeliveryState = Annotated[Literal["waiting", "delivered", "given_up", ""], Query()]


@router.get(PATH)
def get_webhooks(page: CurrentPage, study: str) -> Response:
    """The study's webhooks, including disabled ones."""
    return _webhooks(page, study)


@router.post(PATH)
def post_webhook(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Create a webhook; its secret is shown only once."""
    url = form_values(fields).get("url", "")
    try:
        body = read_form(WebhookIn, {"url": url, "events": fields.getlist("events")})
        issued = _use_case(page, study).create(body.url, body.events)
    except (InvalidInputError, ConflictError) as error:
        return _webhooks(page, study, refused(error, {"url": url}, "url"))
    return _webhooks(page, study, issued=issued)


@router.get(f"{PATH}/{{webhook}}")
def get_webhook(
    page: CurrentPage,
    study: str,
    webhook: uuid.UUID,
    state: DeliveryState = "",
    cursor: Cursor = None,
) -> Response:
    """A webhook and the log of its deliveries, the newest first."""
    hooks = _use_case(page, study)
    hook = hooks.read(webhook)
    deliveries = hooks.list_deliveries(
        webhook, state=state or None, cursor=cursor, limit=DELIVERIES_A_PAGE
    )
    return page.render(
        "webhook.html", hook=hook, rows=deliveries.rows, next=deliveries.cursor, state=state
    )


@router.post(f"{PATH}/{{webhook}}/state")
def post_state(page: CurrentPage, study: str, webhook: uuid.UUID, fields: Fields) -> Response:
    """Disable the webhook and give up waiting deliveries; or enable it if unchanged since the page was opened."""
    values = form_values(fields)
    if values.get("is_enabled") != "true":
        _use_case(page, study).disable(webhook)
        return page.redirect(
            study_address(study, "webhooks", webhook), "Nothing more is sent to it."
        )
    _use_case(page, study).change(webhook, expected=take_version(values), is_enabled=True)
    return page.redirect(
        study_address(study, "webhooks", webhook), "Events are sent to it again from now on."
    )


@router.post(f"{PATH}/{{webhook}}/secret")
def post_secret(page: CurrentPage, study: str, webhook: uuid.UUID) -> Response:
    """Create a new secret, shown once; for a day deliveries are signed with the old one too."""
    return _webhooks(page, study, issued=_use_case(page, study).rotate_secret(webhook))


@router.post(f"{PATH}/{{webhook}}/test")
def post_test(page: CurrentPage, study: str, webhook: uuid.UUID) -> Response:
    """Send a ping."""
    _use_case(page, study).test(webhook)
    return page.redirect(
        study_address(study, "webhooks", webhook),
        "A ping is being sent; the log shows its delivery.",
    )


@router.post(f"{PATH}/{{webhook}}/deliveries/{{delivery}}/replay")
def post_replay(page: CurrentPage, study: str, webhook: uuid.UUID, delivery: uuid.UUID) -> Response:
    """Send the same payload again."""
    _use_case(page, study).replay(webhook, delivery)
    return page.redirect(
        study_address(study, "webhooks", webhook), "It is sent again, as a new delivery."
    )


def _use_case(page: Page, study: str) -> Webhooks:
    state = page.state
    allow_loopback = state.settings.webhook_allow_loopback
    return Webhooks(state.database, state.part(SecretBox), allow_loopback, page.caller, study)


def _webhooks(
    page: Page, study: str, form: FormState = EMPTY_FORM, issued: IssuedSecret | None = None
) -> Response:
    return page.render(
        "webhooks.html",
        form=form,
        rows=_use_case(page, study).list(),
        events=(ALL_EVENTS, *EVENTS),
        url=form.values.get("url", ""),
        issued=issued,
    )
