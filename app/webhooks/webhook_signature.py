"""A webhook's secret and its signatures by Standard Webhooks 1.0.0 (symmetric, `v1`).

For a day after a rotation, deliveries are also signed with the old secret, so that receivers can
switch over.
"""

import base64
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from standardwebhooks import Webhook

from app.people.access.secret_box import SecretBox

SECRET_BYTES = 32  # the standard asks for 24 to 64
PREFIX = "whsec_"
OLD_SECRET_SIGNS = timedelta(days=1)


@dataclass(frozen=True, slots=True)
class SigningSecrets:
    """The current secret and, for a while after a rotation, the previous one."""

    current: str
    previous: str | None = None
    previous_until: datetime | None = None

    def rotated(self, now: datetime) -> "SigningSecrets":
        """Return a new current secret with this one as the previous, valid for OLD_SECRET_SIGNS."""
        return SigningSecrets(new_secret(), self.current, now + OLD_SECRET_SIGNS)

    def signatures(self, delivery_id: str, now: datetime, body: bytes) -> str:
        """Return the header's value: one signature per valid secret, separated by spaces."""
        in_force = [self.current]
        if (
            self.previous is not None
            and self.previous_until is not None
            and now < self.previous_until
        ):
            in_force.append(self.previous)
        return " ".join(
            Webhook(secret).sign(delivery_id, now.astimezone(UTC), body.decode())
            for secret in in_force
        )


def new_secret() -> str:
    """Draw a secret in the standard's format."""
    return PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()


def seal_secrets(box: SecretBox, signing: SigningSecrets) -> str:
    """Encrypt secrets with the server's key."""
    parts = [signing.current]
    if signing.previous is not None and signing.previous_until is not None:
        parts += [signing.previous, signing.previous_until.isoformat()]
    return box.seal(" ".join(parts))


def open_secrets(box: SecretBox, sealed: str) -> SigningSecrets:
    """Decrypt secrets. Raises SecretKeyError if another key sealed them."""
    current, *rest = box.open(sealed).split(" ")
    if not rest:
        return SigningSecrets(current)
    previous, until = rest
    return SigningSecrets(current, previous, datetime.fromisoformat(until))
