"""Manage a study's webhooks: create, change, disable, rotate secrets, test; read and replay the log."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of
from app.http.parameters import require_version
from app.outbox import write as outbox
from app.outbox.models import PING, Webhook, WebhookDelivery
from app.outbox.write import enabled_webhooks
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.access.secret_box import SecretBox, SecretKeyError
from app.people.models import Study
from app.people.studies import enter_study
from app.webhooks import queries as sql
from app.webhooks.safe_address import parse_target, resolve_safely
from app.webhooks.webhook_signature import SigningSecrets, new_secret, open_secrets, seal_secrets

MAX_ENABLED = 10  # per study
MAX_LISTED = 100


@dataclass(frozen=True, slots=True)
class IssuedSecret:
    """A webhook with a new secret, shown once.

    previous_until: end of the old secret's validity, if there is one.
    """

    webhook: Webhook
    secret: str
    previous_until: datetime | None


@dataclass(frozen=True, slots=True)
class Webhooks:
    """The use cases of a study's webhooks, for one caller. Webhooks of other studies are not found.

    All raise NotFoundError, for a study or a webhook that does not exist, and NotAllowedError.
    """

    database: Database
    box: SecretBox
    allow_loopback: bool
    caller: StaffCaller
    study_code: str

    def create(self, url: str, events: Sequence[str]) -> IssuedSecret:
        """Create a webhook.

        Raises AddressError (InvalidInputError), ConflictError (`webhooks_too_many`).
        """
        self._check_url(url)
        secret, now = new_secret(), datetime.now(UTC)
        with self.database.write() as session:
            study = self._enter(session)
            _require_room(session, study.id)
            hook = Webhook(
                id=uuid.uuid4(),
                study_id=study.id,
                url=url,
                events=sorted(set(events)),
                secret_sealed=seal_secrets(self.box, SigningSecrets(secret)),
                author=self.caller.name,
                created_at=now,
            )
            session.add(hook)
            self._note(session, hook, "create", events=hook.events)
        return IssuedSecret(hook, secret, None)

    def list(self) -> list[Webhook]:
        """Return the study's webhooks, the newest first."""
        with self.database.read() as session:
            return sql.list_webhooks(session, self._enter(session).id, MAX_LISTED)

    def read(self, webhook_id: uuid.UUID) -> Webhook:
        """Return a webhook."""
        with self.database.read() as session:
            return self._find(session, webhook_id)

    def change(
        self,
        webhook_id: uuid.UUID,
        *,
        expected: frozenset[int] | None,
        url: str | None = None,
        events: Sequence[str] | None = None,
        is_enabled: bool | None = None,
    ) -> Webhook:
        """Change the fields that are not None.

        expected: versions that the change may be made from; None: any.

        Raises AddressError, ConflictError (`webhooks_too_many`), PreconditionFailedError (changed
        since).
        """
        if url is not None:
            self._check_url(url)
        with self.database.write() as session:
            hook = self._find(session, webhook_id, lock=True)
            require_version(hook.version, expected, "webhook")
            changed = []
            if url is not None and url != hook.url:
                hook.url = url
                changed.append("url")
            if events is not None and sorted(set(events)) != hook.events:
                hook.events = sorted(set(events))
                changed.append("events")
            if is_enabled is not None and is_enabled != (hook.disabled_at is None):
                if is_enabled:
                    _require_room(session, hook.study_id)
                hook.disabled_at = None if is_enabled else datetime.now(UTC)
                changed.append("is_enabled")
            if changed:
                hook.version += 1
                self._note(session, hook, "change", fields=changed)
        return hook

    def disable(self, webhook_id: uuid.UUID) -> None:
        """Disable a webhook; its log stays readable. Repeating it changes nothing."""
        with self.database.write() as session:
            hook = self._find(session, webhook_id, lock=True)
            if hook.disabled_at is None:
                hook.disabled_at = datetime.now(UTC)
                hook.version += 1
                self._note(session, hook, "disable")

    def rotate_secret(self, webhook_id: uuid.UUID) -> IssuedSecret:
        """Create a new secret.

        If TADA_SECRET_KEY does not open the old one, there is no previous secret.
        """
        with self.database.write() as session:
            hook = self._find(session, webhook_id, lock=True)
            try:
                signing = open_secrets(self.box, hook.secret_sealed).rotated(datetime.now(UTC))
            except SecretKeyError:
                signing = SigningSecrets(new_secret())
            hook.secret_sealed = seal_secrets(self.box, signing)
            self._note(session, hook, "rotate_secret")
        return IssuedSecret(hook, signing.current, signing.previous_until)

    def list_deliveries(
        self, webhook_id: uuid.UUID, *, state: str | None, cursor: str | None, limit: int
    ) -> Page[WebhookDelivery]:
        """Return a page of the log, the newest first.

        Raises InvalidInputError for an invalid cursor.
        """
        list_name = f"deliveries {webhook_id.hex} {state}"
        before = decode_cursor(list_name, cursor, INSTANT, ID)
        with self.database.read() as session:
            hook = self._find(session, webhook_id)
            rows = sql.page_of_deliveries(
                session, hook.id, state=state, before=before, limit=limit + 1
            )
        return page_of(list_name, rows, limit, lambda row: (row.created_at, row.id))

    def replay(self, webhook_id: uuid.UUID, delivery_id: uuid.UUID) -> WebhookDelivery:
        """Send the frozen payload again, as a new delivery. Raises ConflictError."""
        with self.database.write() as session:
            hook = _enabled(self._find(session, webhook_id, lock=True))
            old = sql.find_delivery(session, hook.id, delivery_id)
            if old is None:
                raise NotFoundError("This webhook has no such delivery.")
            if "data" not in old.payload:
                raise ConflictError(
                    "The participant's data were removed from this delivery once it had ended.",
                    code="webhook_payload_removed",
                )
            copy = outbox.add_delivery(
                session,
                hook,
                old.event,
                old.payload,
                datetime.now(UTC),
                meal_id=old.meal_id,
                participant_id=old.participant_id,
            )
            self._note(session, hook, "replay", delivery=str(old.id))
        return copy

    def test(self, webhook_id: uuid.UUID) -> WebhookDelivery:
        """Send a `ping`. Raises ConflictError (disabled)."""
        with self.database.write() as session:
            hook = _enabled(self._find(session, webhook_id, lock=True))
            (ping,) = outbox.deliver_to(session, [hook], PING, {})
            self._note(session, hook, "test")
        return ping

    def _enter(self, session: Session) -> Study:
        return enter_study(session, self.caller, self.study_code)

    def _find(self, session: Session, webhook_id: uuid.UUID, *, lock: bool = False) -> Webhook:
        hook = sql.find_webhook(session, self._enter(session).id, webhook_id, lock=lock)
        if hook is None:
            raise NotFoundError("The study has no such webhook.")
        return hook

    def _note(self, session: Session, hook: Webhook, action: str, **details: object) -> None:
        audit.note(
            session,
            self.caller,
            f"webhook.{action}",
            study_id=hook.study_id,
            subject=hook.id,
            **details,
        )

    def _check_url(self, url: str) -> None:
        """Check a URL. Call it outside any transaction, since resolving a name takes time."""
        target = parse_target(url, allow_loopback=self.allow_loopback)
        resolve_safely(target.host, target.port, allow_loopback=self.allow_loopback)


def _enabled(hook: Webhook) -> Webhook:
    if hook.disabled_at is not None:
        raise ConflictError("The webhook is disabled: enable it first.", code="webhook_disabled")
    return hook


def _require_room(session: Session, study_id: uuid.UUID) -> None:
    sql.lock_study(session, study_id)
    if len(enabled_webhooks(session, study_id)) >= MAX_ENABLED:
        raise ConflictError(
            f"The study already has {MAX_ENABLED} enabled webhooks: disable one first.",
            code="webhooks_too_many",
        )
