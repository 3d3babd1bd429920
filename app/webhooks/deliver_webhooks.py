"""Sends what waits in the outbox, at least once, signed, with pauses that grow over three days; then gives up.

A worker's chore starts deliveries and returns; each runs in a thread of its own, few at a time and one a webhook, so
that a slow receiver holds up neither the others nor the other chores. A claim lasts a little longer than a try can: if
the worker dies, another sends it again. After a failure a webhook rests a while in this worker, whatever waits for it.
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
)  # fmt: skip  # between tries: the schedule that Standard Webhooks gives as its example, 75 hours in all
MOST_ATTEMPTS = len(PAUSES) + 1
JITTER = 0.1  # of a pause, either way: what failed together is not tried again together
LONGEST_RETRY_AFTER = timedelta(days=1)
GIVEN_UP_IN_A_ROW = 5  # then the webhook is disabled
CLAIM = timedelta(seconds=6 * TOTAL_SECONDS)  # a try and writing down what came of it take less
AT_ONCE = 8  # deliveries in one worker
TURN_SECONDS = 10.0  # then a webhook with many deliveries makes room for another
ROWS_AT_ONCE = 1000  # a transaction: short ones, on SQLite nobody else writes meanwhile
FIRST_REST_SECONDS, LONGEST_REST_SECONDS = 5.0, 300.0
KEPT = timedelta(days=30)  # of a delivery that has ended
GONE = 410
WITHDRAWN = "participant.withdrawn"
SECRET_UNREADABLE = "The webhook's secret cannot be opened: TADA_SECRET_KEY is not the one it was sealed with."  # noqa: S105


@dataclass(frozen=True, slots=True)
class _Claimed:
    """A delivery that is ours for a while; attempt: its number, from 1. meal_id: whose news it is, for the log."""

    delivery_id: uuid.UUID
    event: str
    meal_id: uuid.UUID | None
    webhook_id: uuid.UUID
    url: str
    secret_sealed: str
    body: bytes
    attempt: int


class DeliverWebhooks:
    """The use case; one a worker. now: another clock in tests."""

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
        self._rests: dict[uuid.UUID, tuple[float, float]] = {}  # webhook -> (rest in seconds, until, monotonic)

    def run(self) -> int:
        """Begin with each webhook that something is due to, as far as there is room. Returns with how many."""
        started = 0
        while (claimed := self._claim_any()) is not None:
            try:
                threading.Thread(target=self._deliver, args=(claimed,), name="webhook", daemon=True).start()
            except RuntimeError:  # the machine has no thread left: the claim runs out
                self._be_done_with(claimed)
                raise
            started += 1
        return started

    def wait_until_idle(self, seconds: float) -> bool:
        """Whether no delivery is under way any more within that time."""
        with self._lock:
            return self._lock.wait_for(lambda: not self._busy, seconds)

    def give_up_unsendable(self) -> None:
        """Give up what waits for a disabled webhook, and what a worker died over at its last try."""
        found = ROWS_AT_ONCE
        while found == ROWS_AT_ONCE:
            with self._database.write() as session:
                rows = webhooks.unsendable(session, self._now(), MOST_ATTEMPTS, ROWS_AT_ONCE)
                for delivery in rows:
                    _give_up(delivery)
                found = len(rows)

    def remove_old(self) -> None:
        """Remove deliveries that have ended, KEPT after their event."""
        removed = ROWS_AT_ONCE
        while removed == ROWS_AT_ONCE:
            with self._database.write() as session:
                removed = webhooks.remove_ended(session, self._now() - KEPT, ROWS_AT_ONCE)

    def _claim_any(self) -> _Claimed | None:
        """A delivery to a webhook that is free, which is busy from here on; None if there is none, or no room."""
        with self._lock:
            if len(self._busy) >= AT_ONCE:
                return None
            resting = {hook for hook, (_, until) in self._rests.items() if time.monotonic() < until}
            passed_over = self._busy | resting
        claimed = self._claim(Due(self._now(), passed_over=frozenset(passed_over)))
        if claimed is not None:
            with self._lock:
                self._busy.add(claimed.webhook_id)
        return claimed

    def _claim(self, due: Due) -> _Claimed | None:
        with self._database.read() as session:  # on SQLite a look must not keep those who write waiting
            if not webhooks.has_due(session, due):
                return None
        with self._database.write() as session:
            found = webhooks.claim_due(session, due, until=due.now + CLAIM)
            if found is None:
                return None
            delivery, hook = found
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
        """Send it and, as long as the receiver takes them and others need not wait, what is due to the same webhook."""
        following: _Claimed | None = claimed
        turn_ends = time.monotonic() + TURN_SECONDS
        try:
            while following is not None:
                answer = self._send(following)
                self._rest_or_go_on(following.webhook_id, answer)
                self._note(following, answer)
                _tell(following, answer)
                goes_on = answer.is_success and time.monotonic() < turn_ends
                following = self._claim(Due(self._now(), only=claimed.webhook_id)) if goes_on else None
        except Exception as error:  # the worker's edge: the claim runs out, and it is tried again
            log.warning("webhook_delivery_failed", delivery_id=str(claimed.delivery_id), exc_info=error)
        finally:
            self._be_done_with(claimed)

    def _be_done_with(self, claimed: _Claimed) -> None:
        with self._lock:
            self._busy.discard(claimed.webhook_id)
            self._lock.notify_all()

    def _send(self, claimed: _Claimed) -> Answer:
        try:
            known = open_secrets(self._box, claimed.secret_sealed)
        except SecretKeyError:
            log.error(  # noqa: TRY400  # the reason is known: no traceback at each try
                "webhook_secret_unreadable", webhook_id=str(claimed.webhook_id), detail=SECRET_UNREADABLE
            )
            return Answer(None, SECRET_UNREADABLE)
        now = self._now()
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"tada-server/{__version__}",
            "Webhook-Id": str(claimed.delivery_id),
            "Webhook-Timestamp": str(int(now.timestamp())),
            "Webhook-Signature": known.signatures(str(claimed.delivery_id), now, claimed.body),
        }
        return self._post.send(claimed.url, headers, claimed.body)

    def _rest_or_go_on(self, webhook_id: uuid.UUID, answer: Answer) -> None:
        with self._lock:
            if answer.is_success:
                self._rests.pop(webhook_id, None)
                return
            before, _ = self._rests.get(webhook_id, (0.0, 0.0))
            seconds = min(max(2 * before, FIRST_REST_SECONDS), LONGEST_REST_SECONDS)
            self._rests[webhook_id] = (seconds, time.monotonic() + seconds)

    def _note(self, claimed: _Claimed, answer: Answer) -> None:
        """Write down what came of it. A row that was erased meanwhile, or delivered by another, is left as it is."""
        with self._database.write() as session:
            found = webhooks.lock_delivery(session, claimed.delivery_id)
            if found is None:
                return
            delivery, hook = found
            if delivery.state != "waiting" or (delivery.attempts != claimed.attempt and not answer.is_success):
                return
            delivery.last_status = answer.status
            delivery.last_error = None if answer.is_success else _words(answer)
            if answer.is_success:
                delivery.state, delivery.delivered_at, delivery.next_try_at = "delivered", self._now(), None
                _forget_who_left(delivery)
                return
            is_given_up = answer.status == GONE or claimed.attempt >= MOST_ATTEMPTS
            if is_given_up:
                _give_up(delivery)
            else:
                delivery.next_try_at = self._now() + self._pause(claimed.attempt, answer)
            session.flush()
            if hook.disabled_at is not None or not is_given_up:
                return
            outcomes = webhooks.last_outcomes(session, hook.id, GIVEN_UP_IN_A_ROW)
            in_a_row = len(outcomes) == GIVEN_UP_IN_A_ROW and set(outcomes) == {"given_up"}
            if answer.status == GONE or in_a_row:
                hook.disabled_at = self._now()
                hook.version += 1
                reason = "gone" if answer.status == GONE else "given_up_in_a_row"
                audit.note(session, None, "webhook.disable", study_id=hook.study_id, subject=hook.id, reason=reason)
                log.warning("webhook_disabled", webhook_id=str(hook.id), reason=reason)

    def _pause(self, attempt: int, answer: Answer) -> timedelta:
        """Until the next try, after this one (from 1) failed."""
        pause = PAUSES[attempt - 1] * self._chance.uniform(1 - JITTER, 1 + JITTER)
        if answer.retry_after_seconds is None:
            return pause
        asked = min(answer.retry_after_seconds, LONGEST_RETRY_AFTER.total_seconds())
        return max(pause, timedelta(seconds=asked))


def _tell(claimed: _Claimed, answer: Answer) -> None:
    """What came of a try, into log and figures: ids, the event and the status; never the address or a payload."""
    is_over = answer.status == GONE or claimed.attempt >= MOST_ATTEMPTS
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


def _words(answer: Answer) -> str:
    """What went wrong, in words of ours: never what the receiver said."""
    return answer.error or f"The receiver answered {answer.status}."


def _give_up(delivery: WebhookDelivery) -> None:
    delivery.state, delivery.next_try_at = "given_up", None
    _forget_who_left(delivery)


def _forget_who_left(delivery: WebhookDelivery) -> None:
    """The notice that a participant left was for delivery only: their code does not stay in the log."""
    if delivery.event == WITHDRAWN:
        delivery.payload = {name: value for name, value in delivery.payload.items() if name != "data"}
