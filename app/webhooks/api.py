"""/v1/studies/{study}/webhooks: who is told of a study's events, and what came of telling them."""

import uuid
from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request, Response

from app.foods.edits.api import IfMatch, expected_versions
from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import StudyCode, WebhookId
from app.http.problems import problem_responses
from app.outbox.models import Webhook
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

router = APIRouter(prefix="/v1/studies/{study}/webhooks", tags=["webhooks"], route_class=ListRoute)

READ = problem_responses(401, 403, 404, 422)
WRITE = problem_responses(401, 403, 404, 409, 413, 422)


@router.post("", status_code=201, responses=WRITE)
def post_webhook(
    study: StudyCode, body: WebhookIn, state: State, owner: CurrentStaff, response: Response
) -> WebhookSecretOut:
    """Make a webhook. Its secret is shown here and never again."""
    issued = _use_case(state).create(owner, study, body.url, body.events)
    response.headers["Location"] = f"/v1/studies/{study}/webhooks/{issued.webhook.id}"
    return _secret_out(issued)


@router.get("", responses=READ)
def get_webhooks(study: StudyCode, state: State, owner: CurrentStaff) -> WebhookList:
    """The study's webhooks, disabled ones too."""
    return WebhookList(items=[_webhook_out(hook) for hook in _use_case(state).list(owner, study)])


@router.get("/{webhook}", responses=READ)
def get_webhook(
    study: StudyCode, webhook: WebhookId, state: State, owner: CurrentStaff, response: Response
) -> WebhookOut:
    """One webhook. `ETag` names its version, for `If-Match`."""
    return _tagged(_use_case(state).read(owner, study, webhook), response)


@router.patch("/{webhook}", responses=problem_responses(401, 403, 404, 409, 412, 413, 422, 428))
def patch_webhook(
    study: StudyCode,
    webhook: WebhookId,
    body: WebhookChangeIn,
    state: State,
    owner: CurrentStaff,
    response: Response,
    if_match: IfMatch = None,
) -> WebhookOut:
    """Change address or events, disable or enable."""
    changed = _use_case(state).change(
        owner,
        study,
        webhook,
        expected=expected_versions(if_match),
        url=body.url,
        events=body.events,
        is_enabled=body.is_enabled,
    )
    return _tagged(changed, response)


@router.delete("/{webhook}", status_code=204, responses=READ)
def delete_webhook(study: StudyCode, webhook: WebhookId, state: State, owner: CurrentStaff) -> Response:
    """Disable: nothing more is sent, what waits is given up; the log stays for its 30 days."""
    _use_case(state).disable(owner, study, webhook)
    return Response(status_code=204)


@router.post("/{webhook}/secret", responses=READ)
def post_secret(study: StudyCode, webhook: WebhookId, state: State, owner: CurrentStaff) -> WebhookSecretOut:
    """A fresh secret, shown once. For a day deliveries carry a signature by the old one too."""
    return _secret_out(_use_case(state).rotate_secret(owner, study, webhook))


@router.post("/{webhook}/test", status_code=202, responses=problem_responses(401, 403, 404, 409, 422))
def post_test(study: StudyCode, webhook: WebhookId, state: State, owner: CurrentStaff) -> DeliveryOut:
    """Send a `ping`; its delivery stands in the log."""
    return DeliveryOut.model_validate(_use_case(state).test(owner, study, webhook), from_attributes=True)


@router.get("/{webhook}/deliveries", responses=READ)
def get_deliveries(
    request: Request,
    study: StudyCode,
    webhook: WebhookId,
    state: State,
    owner: CurrentStaff,
    only: Annotated[
        Literal["waiting", "delivered", "given_up"] | None,
        Query(alias="state", description="Only deliveries of this state."),
    ] = None,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> DeliveryPage:
    """The log, the newest first. Deliveries that ended stay for 30 days."""
    page = _use_case(state).list_deliveries(owner, study, webhook, state=only, cursor=cursor, limit=limit)
    items = [DeliveryOut.model_validate(row, from_attributes=True) for row in page.rows]
    return DeliveryPage(items=items, next=next_page(request, page.cursor))


@router.post(
    "/{webhook}/deliveries/{delivery}/replay", status_code=202, responses=problem_responses(401, 403, 404, 409, 422)
)
def post_replay(
    study: StudyCode,
    webhook: WebhookId,
    delivery: Annotated[uuid.UUID, Path(description="The delivery's id.")],
    state: State,
    owner: CurrentStaff,
) -> DeliveryOut:
    """Send the payload once more, as it was then, as a new delivery."""
    again = _use_case(state).replay(owner, study, webhook, delivery)
    return DeliveryOut.model_validate(again, from_attributes=True)


def _use_case(state: State) -> Webhooks:
    return Webhooks(state.database, state.part(SecretBox), state.settings)


def _tagged(hook: Webhook, response: Response) -> WebhookOut:
    response.headers["ETag"] = f'"{hook.version}"'
    return _webhook_out(hook)


def _webhook_out(hook: Webhook) -> WebhookOut:
    return WebhookOut.model_validate(hook, from_attributes=True)


def _secret_out(issued: IssuedSecret) -> WebhookSecretOut:
    return WebhookSecretOut(
        webhook=_webhook_out(issued.webhook), secret=issued.secret, previous_until=issued.previous_until
    )
