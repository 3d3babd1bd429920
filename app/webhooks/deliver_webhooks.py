"""Send the outbox's deliveries at least once, signed, with retries at growing intervals over three days.

A worker's chore starts deliveries and returns. Each runs in a thread of its own, a few at a time
and one per webhook, so that a slow receiver delays neither other webhooks nor other chores. A claim
lasts a little longer than an attempt can: if the worker dies, another sends the delivery again.
After a failure this worker pauses all deliveries to the webhook for a while.
"""

import json
import random
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import structlog

from app import __version__
from app.db.session import Database
from app.metrics import instruments
from app.outbox.models import WebhookDelivery
from app.people.access import audit
from app.people.access.secret_box import SecretBox, SecretKeyError
from app.webhooks import queries as webhooks
from app.webhooks.queries import Due
from app.webhooks.webhook_post import TOTAL_SECONDS, Answer, WebhookPost
from app.webhooks.webhook_signature import open_secrets

log = structlog.get_logger()

PAUSES = tuple(
    timedelta(**pause)
    for pause in (
        {"seconds": 5}, {"minutes": 5}, {"minutes": 30}, {"hours": 2}, {"hours": 5},
        {"hours": 10}, {"hours": 14}, {"hours": 20}, {"hours": 24},
    )
)  # fmt: skip  # between attempts: the example schedule of Standard Webhooks, 75 hours in all
MAX_ATTEMPTS = len(PAUSES) + 1
# of a pause, in both directions, so that deliveries that failed together are not retried together
JITTER = 0.1
LONGEST_RETRY_AFTER = timedelta(days=1)
MAX_CONSECUTIVE_GIVEN_UP = 5  # then the webhook is disabled
CLAIM = timedelta(seconds=6 * TOTAL_SECONDS)  # longer than an attempt and storing its outcome take
MAX_CONCURRENT = 8  # deliveries in one worker
TURN_SECONDS = 10.0  # then a webhook with many deliveries lets another one go first
ROWS_PER_TRANSACTION = 1000  # keeps transactions short, since SQLite has one writer
FIRST_REST_SECONDS, LONGEST_REST_SECONDS = 5.0, 300.0
KEPT = timedelta(days=30)  # after the event, once the delivery has ended
GONE = 410
WITHDRAWN = "participant.withdrawn"
SECRET_UNREADABLE = (
    "The webhook's secret cannot be opened: TADA_SECRET_KEY is not the one it was sealed with."  # noqa: S105
)


@dataclass(frozen=True, slots=True)
class _Claimed:
    """A delivery that this worker has claimed.

    attempt: its number, from 1. meal_id: for the log.
    """

    delivery_id: uuid.UUID
    event: str
    meal_id: uuid.UUID | None
    webhook_id: uuid.UUID
    url: str
    secret_sealed: str
    body: bytes
    attempt: int


class DeliverWebhooks:
    """Delivers webhooks; one per worker. now, chance: replaced in tests."""

    def __init__(
        self,
        database: Database,
        box: SecretBox,
        post: WebhookPost,
        *,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        chance: random.Random | None = None,
    ) -> None:
        self._database = database
        self._box = box
        self._post = post
        self._now = now
        self._chance = chance or random.SystemRandom()
        self._lock = threading.Condition()
        self._busy: set[uuid.UUID] = set()
        # webhook -> (length in seconds, end by monotonic clock)
        self._rests: dict[uuid.UUID, tuple[float, float]] = {}

    def run(self) -> int:
        """Start a thread for each webhook with a due delivery, up to MAX_CONCURRENT.

        Returns the number started.
        """
        started = 0
        while (claimed := self._claim_any()) is not None:
            try:
                threading.Thread(
                    target=self._deliver, args=(claimed,), name="webhook", daemon=True
                ).start()
            except RuntimeError:  # no thread is available: the claim expires
                self._release_webhook(claimed)
                raise
            started += 1
        return started

    def wait_until_idle(self, seconds: float) -> bool:
        """Wait for running deliveries to end. Returns whether they ended in time."""
        with self._lock:
            return self._lock.wait_for(lambda: not self._busy, seconds)

    def give_up_unsendable(self) -> None:
        """Give up deliveries to disabled webhooks, and those whose worker died during the last attempt."""
        count = ROWS_PER_TRANSACTION
        while count == ROWS_PER_TRANSACTION:
            with self._database.write() as session:
                rows = webhooks.unsendable(session, self._now(), MAX_ATTEMPTS, ROWS_PER_TRANSACTION)
                for delivery in rows:
                    _give_up(delivery)
                count = len(rows)

    def remove_old(self) -> None:
        """Remove deliveries that have ended, KEPT after their event."""
        removed = ROWS_PER_TRANSACTION
        while removed == ROWS_PER_TRANSACTION:
            with self._database.write() as session:
                removed = webhooks.remove_ended(session, self._now() - KEPT, ROWS_PER_TRANSACTION)

    def _claim_any(self) -> _Claimed | None:
        """Claim a delivery to a webhook that is neither busy nor resting; None if there is none, or no free slot."""
        with self._lock:
            if len(self._busy) >= MAX_CONCURRENT:
                return None
            resting = {hook for hook, (_, until) in self._rests.items() if time.monotonic() < until}
            excluded = self._busy | resting
        claimed = self._claim(Due(self._now(), excluded=frozenset(excluded)))
        if claimed is not None:
            with self._lock:
                self._busy.add(claimed.webhook_id)
        return claimed

    def _claim(self, due: Due) -> _Claimed | None:
        # usually nothing is due, and no write lock is needed
        with self._database.read() as session:
            if not webhooks.has_due(session, due):
                return None
        with self._database.write() as session:
            row = webhooks.claim_due(session, due, until=due.now + CLAIM)
            if row is None:
                return None
            delivery, hook = row
            body = json.dumps(delivery.payload, sort_keys=True, separators=(",", ":")).encode()
            return _Claimed(
                delivery.id,
                delivery.event,
                delivery.meal_id,
                hook.id,
                hook.url,
                hook.secret_sealed,
                body,
                delivery.attempts,
            )

    def _deliver(self, claimed: _Claimed) -> None:
        """Send a delivery, then further ones to the same webhook until one fails or TURN_SECONDS have passed."""
        current: _Claimed | None = claimed
        turn_ends = time.monotonic() + TURN_SECONDS
        try:
            while current is not None:
                answer = self._send(current)
                self._update_rest(current.webhook_id, answer)
                self._store_outcome(current, answer)
                _log_attempt(current, answer)
                may_continue = answer.is_success and time.monotonic() < turn_ends
                current = (
                    self._claim(Due(self._now(), only=claimed.webhook_id)) if may_continue else None
                )
        # the worker's edge: the claim expires, and the delivery is sent again
        except Exception as error:
            log.warning(
                "webhook_delivery_failed", delivery_id=str(claimed.delivery_id), exc_info=error
            )
        finally:
            self._release_webhook(claimed)

    def _release_webhook(self, claimed: _Claimed) -> None:
        with self._lock:
            self._busy.discard(claimed.webhook_id)
            self._lock.notify_all()

    def _send(self, claimed: _Claimed) -> Answer:
        try:
            signing = open_secrets(self._box, claimed.secret_sealed)
        except SecretKeyError:
            log.error(  # noqa: TRY400  # the cause is clear: no traceback for each attempt
                "webhook_secret_unreadable",
                webhook_id=str(claimed.webhook_id),
                detail=SECRET_UNREADABLE,
            )
            return Answer(None, SECRET_UNREADABLE)
        now = self._now()
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"tada-server/{__version__}",
            "Webhook-Id": str(claimed.delivery_id),
            "Webhook-Timestamp": str(int(now.timestamp())),
            "Webhook-Signature": signing.signatures(str(claimed.delivery_id), now, claimed.body),
        }
        return self._post.send(claimed.url, headers, claimed.body)

    def _update_rest(self, webhook_id: uuid.UUID, answer: Answer) -> None:
        """End the webhook's rest after a success; start one, twice as long as the last, after a failure."""
        with self._lock:
            if answer.is_success:
                self._rests.pop(webhook_id, None)
                return
            previous_seconds, _ = self._rests.get(webhook_id, (0.0, 0.0))
            seconds = min(max(2 * previous_seconds, FIRST_REST_SECONDS), LONGEST_REST_SECONDS)
            self._rests[webhook_id] = (seconds, time.monotonic() + seconds)

    def _store_outcome(self, claimed: _Claimed, answer: Answer) -> None:
        """Store an attempt's outcome, unless the row was erased or another worker delivered it meanwhile."""
        with self._database.write() as session:
            row = webhooks.lock_delivery(session, claimed.delivery_id)
            if row is None:
                return
            delivery, hook = row
            if delivery.state != "waiting" or (
                delivery.attempts != claimed.attempt and not answer.is_success
            ):
                return
            delivery.last_status = answer.status
            delivery.last_error = None if answer.is_success else _error_message(answer)
            if answer.is_success:
                delivery.state, delivery.delivered_at, delivery.next_try_at = (
                    "delivered",
                    self._now(),
                    None,
                )
                _remove_withdrawal_data(delivery)
                return
            is_given_up = answer.status == GONE or claimed.attempt >= MAX_ATTEMPTS
            if is_given_up:
                _give_up(delivery)
            else:
                delivery.next_try_at = self._now() + self._pause(claimed.attempt, answer)
            session.flush()
            if hook.disabled_at is not None or not is_given_up:
                return
            outcomes = webhooks.last_outcomes(session, hook.id, MAX_CONSECUTIVE_GIVEN_UP)
            all_given_up = len(outcomes) == MAX_CONSECUTIVE_GIVEN_UP and set(outcomes) == {
                "given_up"
            }
            if answer.status == GONE or all_given_up:
                hook.disabled_at = self._now()
                hook.version += 1
                reason = "gone" if answer.status == GONE else "given_up_in_a_row"
                audit.note(
                    session,
                    None,
                    "webhook.disable",
                    study_id=hook.study_id,
                    subject=hook.id,
                    reason=reason,
                )
                log.warning("webhook_disabled", webhook_id=str(hook.id), reason=reason)

    def _pause(self, attempt: int, answer: Answer) -> timedelta:
        """Return the time until the next attempt, after an attempt (from 1) failed."""
        pause = PAUSES[attempt - 1] * self._chance.uniform(1 - JITTER, 1 + JITTER)
        if answer.retry_after_seconds is None:
            return pause
        retry_after = min(answer.retry_after_seconds, LONGEST_RETRY_AFTER.total_seconds())
        return max(pause, timedelta(seconds=retry_after))


def _log_attempt(claimed: _Claimed, answer: Answer) -> None:
    """Log and count an attempt with ids, event and status; never the address or the payload."""
    is_over = answer.status == GONE or claimed.attempt >= MAX_ATTEMPTS
    outcome = "delivered" if answer.is_success else "given_up" if is_over else "failed"
    instruments.DELIVERIES.labels(outcome).inc()
    log.info(
        "webhook_tried",
        outcome=outcome,
        webhook_event=claimed.event,
        delivery_id=str(claimed.delivery_id),
        webhook_id=str(claimed.webhook_id),
        attempt=claimed.attempt,
        status=answer.status,
        **({"meal_id": str(claimed.meal_id)} if claimed.meal_id is not None else {}),
    )


def _error_message(answer: Answer) -> str:
    """Describe a failure without any text of the receiver's."""
    return answer.error or f"The receiver answered {answer.status}."


def _give_up(delivery: WebhookDelivery) -> None:
    delivery.state, delivery.next_try_at = "given_up", None
    _remove_withdrawal_data(delivery)


def _remove_withdrawal_data(delivery: WebhookDelivery) -> None:
    """Remove the participant's code from the delivered notice of a withdrawal, so that the log does not keep it."""
    if delivery.event == WITHDRAWN:
        delivery.payload = {
            name: value for name, value in delivery.payload.items() if name != "data"
        }
