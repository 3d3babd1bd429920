"""A study's webhooks: made, changed, disabled, given new secrets and tested; their log read and replayed."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError, PreconditionFailedError
from app.core.settings import Settings
from app.db.session import Database
from app.http.cursors import ID, INSTANT, Page, decode_cursor, encode_cursor
from app.outbox import write as outbox
from app.outbox.models import PING, Webhook, WebhookDelivery
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.access.secret_box import SecretBox, SecretKeyError
from app.people.models import Study
from app.people.studies import enter_study
from app.webhooks import queries as sql
from app.webhooks.safe_address import parse_target, resolve_safely
from app.webhooks.webhook_signature import SigningSecrets, new_secret, open_secrets, seal_secrets

MOST_ENABLED = 10  # a study
LISTED = 100


@dataclass(frozen=True, slots=True)
class IssuedSecret:
    """A webhook with a fresh secret, shown once. previous_until: so long the old one signs along, if there is any."""

    webhook: Webhook
    secret: str
    previous_until: datetime | None


class Webhooks:
    """The use case. A webhook of another study does not exist here: NotFoundError."""

    def __init__(self, database: Database, box: SecretBox, settings: Settings) -> None:
        self._database = database
        self._box = box
        self._settings = settings

    def create(self, caller: StaffCaller, study_code: str, url: str, events: Sequence[str]) -> IssuedSecret:
        """A new webhook. Raises AddressError (InvalidInputError), ConflictError (too many), NotFoundError."""
        self._check_url(url)
        secret, now = new_secret(), datetime.now(UTC)
        with self._database.write() as session:
            study = enter_study(session, caller, study_code)
            _require_room(session, study)
            hook = Webhook(
                id=uuid.uuid4(),
                study_id=study.id,
                url=url,
                events=sorted(set(events)),
                secret_sealed=seal_secrets(self._box, SigningSecrets(secret)),
                author=caller.name,
                created_at=now,
            )
            session.add(hook)
            audit.note(session, caller, "webhook.create", study_id=study.id, subject=hook.id, events=hook.events)
        return IssuedSecret(hook, secret, None)

    def list(self, caller: StaffCaller, study_code: str) -> list[Webhook]:
        """The study's webhooks, the newest first."""
        with self._database.read() as session:
            return sql.list_webhooks(session, enter_study(session, caller, study_code).id, LISTED)

    def read(self, caller: StaffCaller, study_code: str, webhook_id: uuid.UUID) -> Webhook:
        """One webhook."""
        with self._database.read() as session:
            return _webhook(session, caller, study_code, webhook_id)

    def change(
        self,
        caller: StaffCaller,
        study_code: str,
        webhook_id: uuid.UUID,
        *,
        expected: frozenset[int] | None,
        url: str | None = None,
        events: Sequence[str] | None = None,
        is_enabled: bool | None = None,
    ) -> Webhook:
        """Change what is not None. expected: versions that it is a change of; None: whatever is there.

        Raises AddressError, ConflictError (too many enabled), NotFoundError, PreconditionFailedError (changed since).
        """
        if url is not None:
            self._check_url(url)
        with self._database.write() as session:
            hook = _webhook(session, caller, study_code, webhook_id, lock=True)
            if expected is not None and hook.version not in expected:
                raise PreconditionFailedError(
                    "The webhook was changed after you read it: read it again, then change it.", version=hook.version
                )
            changed = []
            if url is not None and url != hook.url:
                hook.url = url
                changed.append("url")
            if events is not None and sorted(set(events)) != hook.events:
                hook.events = sorted(set(events))
                changed.append("events")
            if is_enabled is not None and is_enabled != (hook.disabled_at is None):
                if is_enabled:
                    _require_room(session, session.get_one(Study, hook.study_id))
                hook.disabled_at = None if is_enabled else datetime.now(UTC)
                changed.append("is_enabled")
            if changed:
                hook.version += 1
                audit.note(session, caller, "webhook.change", study_id=hook.study_id, subject=hook.id, fields=changed)
        return hook

    def disable(self, caller: StaffCaller, study_code: str, webhook_id: uuid.UUID) -> None:
        """Send nothing more to it; its log stays to be read. Doing it again changes nothing."""
        with self._database.write() as session:
            hook = _webhook(session, caller, study_code, webhook_id, lock=True)
            if hook.disabled_at is None:
                hook.disabled_at = datetime.now(UTC)
                hook.version += 1
                audit.note(session, caller, "webhook.disable", study_id=hook.study_id, subject=hook.id)

    def rotate_secret(self, caller: StaffCaller, study_code: str, webhook_id: uuid.UUID) -> IssuedSecret:
        """A fresh secret. One that TADA_SECRET_KEY does not open any more is replaced without an old one beside it."""
        now = datetime.now(UTC)
        with self._database.write() as session:
            hook = _webhook(session, caller, study_code, webhook_id, lock=True)
            known = self._open_or_new(hook, now)
            hook.secret_sealed = seal_secrets(self._box, known)
            audit.note(session, caller, "webhook.rotate_secret", study_id=hook.study_id, subject=hook.id)
        return IssuedSecret(hook, known.current, known.previous_until)

    def list_deliveries(
        self,
        caller: StaffCaller,
        study_code: str,
        webhook_id: uuid.UUID,
        *,
        state: str | None,
        cursor: str | None,
        limit: int,
    ) -> Page[WebhookDelivery]:
        """The log, the newest first. Raises InvalidInputError for a cursor that is broken or of another list."""
        listed = f"deliveries {webhook_id.hex} {state}"
        before = decode_cursor(listed, cursor, INSTANT, ID)
        with self._database.read() as session:
            hook = _webhook(session, caller, study_code, webhook_id)
            rows = sql.page_of_deliveries(session, hook.id, state=state, before=before, limit=limit + 1)
        if len(rows) <= limit:
            return Page(rows, None)
        last = rows[limit - 1]
        return Page(rows[:limit], encode_cursor(listed, last.created_at, last.id))

    def replay(
        self, caller: StaffCaller, study_code: str, webhook_id: uuid.UUID, delivery_id: uuid.UUID
    ) -> WebhookDelivery:
        """Send the frozen payload again, as a new delivery. Raises NotFoundError, ConflictError."""
        now = datetime.now(UTC)
        with self._database.write() as session:
            hook = _enabled(_webhook(session, caller, study_code, webhook_id, lock=True))
            old = sql.find_delivery(session, hook.id, delivery_id)
            if old is None:
                raise NotFoundError("This webhook has no such delivery.")
            if "data" not in old.payload:
                raise ConflictError(
                    "What this delivery said of a participant was removed after it.", code="webhook_payload_removed"
                )
            again = WebhookDelivery(
                id=uuid.uuid4(),
                webhook_id=hook.id,
                event=old.event,
                payload=old.payload,
                meal_id=old.meal_id,
                participant_id=old.participant_id,
                state="waiting",
                attempts=0,
                next_try_at=now,
                created_at=now,
            )
            session.add(again)
            audit.note(session, caller, "webhook.replay", study_id=hook.study_id, subject=hook.id, delivery=str(old.id))
        return again

    def test(self, caller: StaffCaller, study_code: str, webhook_id: uuid.UUID) -> WebhookDelivery:
        """Send a `ping`. Raises NotFoundError, ConflictError (disabled)."""
        with self._database.write() as session:
            hook = _enabled(_webhook(session, caller, study_code, webhook_id, lock=True))
            (ping,) = outbox.deliver_to(session, [hook], PING, {})
            audit.note(session, caller, "webhook.test", study_id=hook.study_id, subject=hook.id)
        return ping

    def _check_url(self, url: str) -> None:
        """Before any transaction: a name's resolution takes its time."""
        allow = self._settings.webhook_allow_loopback
        resolve_safely(parse_target(url, allow_loopback=allow), allow_loopback=allow)

    def _open_or_new(self, hook: Webhook, now: datetime) -> SigningSecrets:
        try:
            return open_secrets(self._box, hook.secret_sealed).rotated(now)
        except SecretKeyError:
            return SigningSecrets(new_secret())


def _webhook(
    session: Session, caller: StaffCaller, study_code: str, webhook_id: uuid.UUID, *, lock: bool = False
) -> Webhook:
    study = enter_study(session, caller, study_code)
    hook = sql.find_webhook(session, study.id, webhook_id, lock=lock)
    if hook is None:
        raise NotFoundError("The study has no such webhook.")
    return hook


def _enabled(hook: Webhook) -> Webhook:
    if hook.disabled_at is not None:
        raise ConflictError("The webhook is disabled: enable it first.", code="webhook_disabled")
    return hook


def _require_room(session: Session, study: Study) -> None:
    sql.lock_study(session, study.id)
    if len(sql.enabled_webhooks(session, study.id)) >= MOST_ENABLED:
        raise ConflictError(
            f"The study has {MOST_ENABLED} webhooks already: disable one first.", code="webhooks_too_many"
        )
