"""/v1/studies/{study}/webhooks: subscriptions to a study's events, and the log of deliveries."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit
from app.http.parameters import IfMatch, StudyCode, WebhookId, expected_versions
from app.http.problems import problem_responses
from app.outbox.models import DeliveryState, Webhook, WebhookDelivery
from app.people.access.deps import CurrentStaff, State
from app.people.access.secret_box import SecretBox
from app.webhooks.schemas import (
    DeliveryOut,
    DeliveryPage,
    WebhookChangeIn,
    WebhookIn,
    WebhookList,
    WebhookOut,
    WebhookSecretOut,
)
from app.webhooks.webhooks import IssuedSecret, Webhooks

router = APIRouter(
    prefix="/v1/studies/{study}/webhooks",
    tags=["webhooks"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 404, 422),
)

WRITE = problem_responses(409, 413)


def _webhooks(study: StudyCode, state: State, owner: CurrentStaff) -> Webhooks:
    return Webhooks(
        state.database, state.part(SecretBox), state.settings.webhook_allow_loopback, owner, study
    )


Hooks = Annotated[Webhooks, Depends(_webhooks)]


@router.post("", status_code=201, responses=WRITE)
def post_webhook(hooks: Hooks, body: WebhookIn, response: Response) -> WebhookSecretOut:
    """Create a webhook. Its secret is shown only once."""
    issued = hooks.create(body.url, body.events)
    response.headers["Location"] = f"/v1/studies/{hooks.study_code}/webhooks/{issued.webhook.id}"
    return _secret_out(issued)


@router.get("")
def get_webhooks(hooks: Hooks) -> WebhookList:
    """The study's webhooks, including disabled ones."""
    return WebhookList(items=[_webhook_out(hook) for hook in hooks.list()])


@router.get("/{webhook}")
def get_webhook(hooks: Hooks, webhook: WebhookId, response: Response) -> WebhookOut:
    """A webhook. Send its `ETag` in `If-Match` to change it."""
    return _tagged(hooks.read(webhook), response)


@router.patch("/{webhook}", responses=problem_responses(409, 412, 413, 428))
def patch_webhook(
    hooks: Hooks,
    webhook: WebhookId,
    body: WebhookChangeIn,
    response: Response,
    if_match: IfMatch = None,
) -> WebhookOut:
    """Change the address or events, disable or enable the webhook."""
    expected = expected_versions(if_match)
    changed = hooks.change(
        webhook, expected=expected, url=body.url, events=body.events, is_enabled=body.is_enabled
    )
    return _tagged(changed, response)


@router.delete("/{webhook}", status_code=204)
def delete_webhook(hooks: Hooks, webhook: WebhookId) -> Response:
    """Disable the webhook: waiting deliveries are given up; the log stays for its 30 days."""
    hooks.disable(webhook)
    return Response(status_code=204)


@router.post("/{webhook}/secret")
def post_secret(hooks: Hooks, webhook: WebhookId) -> WebhookSecretOut:
    """Create a new secret, shown once. For a day deliveries also carry a signature with the old one."""
    return _secret_out(hooks.rotate_secret(webhook))


@router.post("/{webhook}/test", status_code=202, responses=problem_responses(409))
def post_test(hooks: Hooks, webhook: WebhookId) -> DeliveryOut:
    """Send a `ping`; its delivery appears in the log."""
    return _delivery_out(hooks.test(webhook))


@router.get("/{webhook}/deliveries")
def get_deliveries(
    request: Request,
    hooks: Hooks,
    webhook: WebhookId,
    only: Annotated[
        DeliveryState | None, Query(alias="state", description="Only deliveries of this state.")
    ] = None,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> DeliveryPage:
    """The log of deliveries, the newest first. Deliveries that have ended are kept for 30 days."""
    page = hooks.list_deliveries(webhook, state=only, cursor=cursor, limit=limit)
    return DeliveryPage.of(request, page, _delivery_out)


@router.post(
    "/{webhook}/deliveries/{delivery}/replay", status_code=202, responses=problem_responses(409)
)
def post_replay(
    hooks: Hooks,
    webhook: WebhookId,
    delivery: Annotated[uuid.UUID, Path(description="The delivery's id.")],
) -> DeliveryOut:
    """Send the same payload again, as a new delivery."""
    return _delivery_out(hooks.replay(webhook, delivery))


def _tagged(hook: Webhook, response: Response) -> WebhookOut:
    response.headers["ETag"] = f'"{hook.version}"'
    return _webhook_out(hook)


def _webhook_out(hook: Webhook) -> WebhookOut:
    return WebhookOut.model_validate(hook, from_attributes=True)


def _delivery_out(delivery: WebhookDelivery) -> DeliveryOut:
    return DeliveryOut.model_validate(delivery, from_attributes=True)


def _secret_out(issued: IssuedSecret) -> WebhookSecretOut:
    return WebhookSecretOut.model_validate(issued, from_attributes=True)
