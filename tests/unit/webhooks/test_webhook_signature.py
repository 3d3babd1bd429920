"""Signatures as Standard Webhooks defines them, and secrets at rest."""

import base64
from datetime import UTC, datetime, timedelta

import pytest

from app.people.access.secret_box import SecretBox, SecretKeyError
from app.webhooks.webhook_signature import SigningSecrets, new_secret, open_secrets, seal_secrets

NOW = datetime(2026, 11, 21, 12, 0, 0, 900_000, tzinfo=UTC)
BOX = SecretBox("a key for tests only, of no worth")


def sign(secret, delivery_id, timestamp_s, body):
    return SigningSecrets(secret).signatures(delivery_id, datetime.fromtimestamp(timestamp_s, UTC), body)


def test_signature_and_secrets_are_those_of_the_standard_and_each_part_is_signed():
    # The example that the standard's libraries are tested with.
    found = sign(
        "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}'
    )
    assert found == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
    drawn = {new_secret() for _ in range(100)}
    assert len(drawn) == 100
    assert all(24 <= len(base64.b64decode(secret.removeprefix("whsec_"), validate=True)) <= 64 for secret in drawn)
    secret = new_secret()
    signatures = {
        sign(secret, "a", 1, b"body"),
        sign(secret, "b", 1, b"body"),
        sign(secret, "a", 2, b"body"),
        sign(secret, "a", 1, b"bodY"),
        sign(new_secret(), "a", 1, b"body"),
    }
    assert len(signatures) == 5


def test_old_secret_also_signs_until_it_expires_and_a_second_rotation_forgets_it():
    first = SigningSecrets(new_secret())
    second = first.rotated(NOW)
    within, after = NOW + timedelta(hours=23), NOW + timedelta(hours=25)
    assert second.previous == first.current
    assert second.signatures("a", within, b"") == " ".join(
        sign(secret, "a", int(within.timestamp()), b"") for secret in (second.current, first.current)
    )
    assert second.signatures("a", after, b"") == sign(second.current, "a", int(after.timestamp()), b"")
    third = first.rotated(NOW).rotated(NOW)
    assert first.current not in (third.current, third.previous)


@pytest.mark.parametrize("known", [SigningSecrets(new_secret()), SigningSecrets(new_secret()).rotated(NOW)])
def test_sealed_secrets_open_again_and_fit_their_column(known):
    sealed = seal_secrets(BOX, known)
    assert open_secrets(BOX, sealed) == known
    assert known.current not in sealed
    assert len(sealed) <= 300


def test_secrets_sealed_under_another_key_do_not_open():
    sealed = seal_secrets(SecretBox("another key, of a server that was set up anew"), SigningSecrets(new_secret()))
    with pytest.raises(SecretKeyError):
        open_secrets(BOX, sealed)
