"""Send what is due, once: a reminder that the push service does not take is not repeated, since it would come late.

A worker's chore moves each subscription on before it sends, in one transaction, so that of two workers one reminds.
Sending has a thread of its own, so that a slow push service delays no other chore. A worker that ends moves back what
it has not begun to send, for another one.
"""

import asyncio
import json
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal
from zoneinfo import ZoneInfo

import structlog

from app.core.settings import Settings
from app.db.session import Database
from app.extras.reminders import queries
from app.extras.reminders.subscriptions import is_quiet_for, next_at
from app.extras.reminders.web_push import Receiver, VapidKey, bytes_of, encrypt, origin_of
from app.jobs.chores import Chore
from app.people.access.secret_box import SecretBox
from app.people.models import PushSubscription
from app.webhooks.webhook_post import AsyncSend, WebhookPost

log = structlog.get_logger()

Kind = Literal["meal", "after_meal"]
BATCH = 200
MAX_BATCHES = 100  # in one run; what is left waits for the next run
AT_ONCE = 64  # messages under way in one worker
LATE = timedelta(minutes=30)  # a reminder that is later, since no worker ran, is left out
BEFORE_END = timedelta(minutes=30)  # of an after-meal window
LOOK_AGAIN = timedelta(days=1)  # at a phone whose time zone is not known here
KEPT_SECONDS = 30 * 60  # by the push service, for a phone that is off
# for messages under way when the worker ends; the other chores' ends come after it
END_SECONDS = 2.0
GONE = frozenset({404, 410})  # RFC 8030, section 7.3: the browser has unsubscribed
COLUMNS: dict[Kind, str] = {"meal": "next_at", "after_meal": "after_reminded_at"}


def reminder_chores(database: Database, box: SecretBox, settings: Settings) -> list[Chore]:
    """Return what sends reminders in a worker; nothing on a server that sends none."""
    if settings.push_contact is None:
        return []
    post = WebhookPost(allow_loopback=settings.webhook_allow_loopback)
    reminders = SendReminders(database, box, post, settings.push_contact)
    return [Chore("send_reminders", 20.0, reminders.run, at_end=reminders.stop)]


@dataclass(frozen=True, slots=True)
class _Message:
    """subscription: moved on. before: the value of the column that says when it is due, before it was moved on."""

    subscription: PushSubscription
    kind: Kind
    before: datetime | None


@dataclass(frozen=True, slots=True)
class _Batch:
    """is_full: there may be more that is due."""

    messages: list[_Message]
    is_full: bool


class SendReminders:
    """The chore of one process. now: replaced in tests."""

    def __init__(
        self,
        database: Database,
        box: SecretBox,
        post: WebhookPost,
        contact: str,
        *,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._database, self._post, self._contact, self._now = database, post, contact, now
        self._key = VapidKey(box)
        self._sending: threading.Thread | None = None
        self._waiting: deque[_Message] = deque()  # moved on, not yet begun
        self._is_ending = False

    def run(self) -> int:
        """Start to send what is due, batch after batch. Returns the number of messages of the first batch.

        While an earlier run is sending, nothing is started: 0.
        """
        if self._is_ending or (self._sending is not None and self._sending.is_alive()):
            return 0
        batch = self._take_due()
        if batch.messages or batch.is_full:
            self._sending = threading.Thread(
                target=self._send_all, args=(batch,), name="reminders", daemon=True
            )
            self._sending.start()
        return len(batch.messages)

    def wait_until_idle(self, seconds: float) -> None:
        """Wait for messages under way."""
        if self._sending is not None:
            self._sending.join(seconds)

    def stop(self) -> None:
        """Begin no further message, move back what waits, and wait a little for messages under way."""
        self._is_ending = True
        self._move_back_waiting()
        self.wait_until_idle(END_SECONDS)

    def _take_due(self) -> _Batch:
        now = self._now()
        messages: list[_Message] = []
        late = 0
        with self._database.write() as session:
            due = queries.due(session, now, BATCH)
            for row, study_times in due:
                before = row.next_at
                is_late = before is not None and before < now - LATE
                late += is_late
                if _schedule(row, study_times, now) and not is_late:
                    messages.append(_Message(row, "meal", before))
            unscheduled = queries.unscheduled(session, BATCH)
            for row, study_times in unscheduled:
                _schedule(row, study_times, now)
            ending = queries.windows_ending(session, now, now + BEFORE_END, BATCH)
            for row, ends_at in ending:
                before = row.after_reminded_at
                is_first = before is None or before < ends_at  # of several meals
                row.after_reminded_at = max(before or ends_at, ends_at)
                zone = zone_of(row)
                if (
                    is_first
                    and zone is not None
                    and not is_quiet_for(row, now.astimezone(zone).time())
                ):
                    messages.append(_Message(row, "after_meal", before))
            session.flush()
            session.expunge_all()
        if late:
            log.warning("reminders_too_late", count=late)
        return _Batch(messages, is_full=BATCH in {len(due), len(unscheduled), len(ending)})

    def _send_all(self, batch: _Batch) -> None:
        try:
            asyncio.run(self._send_batches(batch))
        except Exception:  # the thread's edge: the next run takes what is still due
            log.exception("reminders_broken_off")

    async def _send_batches(self, batch: _Batch) -> None:
        """Send batch after batch; a message that takes long holds one of AT_ONCE places, and no other message up."""
        free = asyncio.Semaphore(AT_ONCE)
        under_way: set[asyncio.Task[None]] = set()
        authorizations: dict[str, str] = {}  # by push service

        def end(task: asyncio.Task[None]) -> None:
            under_way.discard(task)
            free.release()
            if not task.cancelled() and (error := task.exception()) is not None:
                log.error("reminder_failed", exc_info=error)

        async with self._post.kept_connections() as send:
            try:
                for _ in range(MAX_BATCHES):
                    self._waiting.extend(batch.messages)
                    while self._waiting and not self._is_ending:
                        await free.acquire()
                        message = self._next_waiting()
                        if message is None:  # stop() has moved them back
                            break
                        task = asyncio.create_task(self._send(message, send, authorizations))
                        under_way.add(task)
                        task.add_done_callback(end)
                    if not batch.is_full or self._is_ending:
                        break
                    batch = await asyncio.to_thread(self._take_due)
            finally:  # whatever fails, these rows have been moved on
                try:
                    await asyncio.to_thread(self._move_back_waiting)
                finally:
                    if under_way:
                        await asyncio.wait(under_way)

    async def _send(
        self, message: _Message, send: AsyncSend, authorizations: dict[str, str]
    ) -> None:
        row = message.subscription
        receiver = Receiver(bytes_of(row.public_key), bytes_of(row.auth))
        service = origin_of(row.endpoint)
        if service not in authorizations:
            authorizations[service] = self._key.authorization(
                service, self._contact, datetime.now(UTC)
            )
        headers = {
            "Authorization": authorizations[service],
            "Content-Encoding": "aes128gcm",
            "Content-Type": "application/octet-stream",
            "TTL": str(KEPT_SECONDS),
            "Topic": message.kind,  # an older one that was not delivered yet is replaced
        }
        answer = await send(
            row.endpoint, headers, encrypt(json.dumps({"kind": message.kind}).encode(), receiver)
        )
        if answer.status in GONE:
            await asyncio.to_thread(self._remove, row)
        if not answer.is_success:
            log.warning(
                "reminder_not_sent", kind=message.kind, status=answer.status, error=answer.error
            )

    def _next_waiting(self) -> _Message | None:
        """Return a message that nobody else will: the sending thread and stop() both take them."""
        try:
            return self._waiting.popleft()
        except IndexError:
            return None

    def _move_back_waiting(self) -> None:
        """Make due again what waits to be sent, where the phone has not changed its subscription meanwhile."""
        messages = list(iter(self._next_waiting, None))
        if not messages:
            return
        with self._database.write() as session:
            for message in messages:
                queries.move_back(
                    session, message.subscription, COLUMNS[message.kind], message.before
                )
        log.info("reminders_moved_back", count=len(messages))

    def _remove(self, row: PushSubscription) -> None:
        with self._database.write() as session:
            queries.remove_subscription(session, row.device_id, row.endpoint)


def _schedule(row: PushSubscription, study_times: Sequence[str], now: datetime) -> bool:
    """Set when the phone is reminded next. Returns False, and puts it off, if its time zone is not known here."""
    if zone_of(row) is None:
        row.next_at = now + LOOK_AGAIN
        return False
    row.next_at = next_at(row, study_times, now)
    return True


def zone_of(row: PushSubscription) -> ZoneInfo | None:
    """Return the phone's time zone; None if this machine does not know it."""
    try:
        return ZoneInfo(row.time_zone)
    # known when the phone subscribed; this machine has other time zone data
    except (KeyError, ValueError):
        log.warning("time_zone_unknown", time_zone=row.time_zone)
        return None
