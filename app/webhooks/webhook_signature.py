"""A webhook's secret and its signatures, as Standard Webhooks 1.0.0 has them (symmetric, `v1`).

After a rotation the old secret signs along for a day, so that a receiver can change over without losing anything.
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
    """The secret in force and, for a while, the one before it."""

    current: str
    previous: str | None = None
    previous_until: datetime | None = None

    def rotated(self, now: datetime) -> "SigningSecrets":
        """A fresh secret; the one in force until now signs along for OLD_SECRET_SIGNS."""
        return SigningSecrets(new_secret(), self.current, now + OLD_SECRET_SIGNS)

    def signatures(self, delivery_id: str, now: datetime, body: bytes) -> str:
        """The header's value: a signature a secret, space between, at this second."""
        in_force = [self.current]
        if self.previous is not None and self.previous_until is not None and now < self.previous_until:
            in_force.append(self.previous)
        return " ".join(Webhook(secret).sign(delivery_id, now.astimezone(UTC), body.decode()) for secret in in_force)


def new_secret() -> str:
    """A fresh secret in the standard's form."""
    return PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()


def seal_secrets(box: SecretBox, known: SigningSecrets) -> str:
    """The secrets as text that only the server's key opens."""
    parts = [known.current]
    if known.previous is not None and known.previous_until is not None:
        parts += [known.previous, known.previous_until.isoformat()]
    return box.seal(" ".join(parts))


def open_secrets(box: SecretBox, sealed: str) -> SigningSecrets:
    """The secrets again. Raises SecretKeyError where another key sealed them."""
    current, *before = box.open(sealed).split(" ")
    if not before:
        return SigningSecrets(current)
    previous, until = before
    return SigningSecrets(current, previous, datetime.fromisoformat(until))
