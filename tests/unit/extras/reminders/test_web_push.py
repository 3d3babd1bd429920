"""Messages that only the browser reads, and the proof of their sender: RFC 8291's own example, and the way back."""

import json
from datetime import UTC, datetime, timedelta

import pytest
from cryptography.exceptions import InvalidSignature, InvalidTag
from cryptography.hazmat.primitives.asymmetric import ec

from app.extras.reminders.web_push import CURVE, Receiver, VapidKey, bytes_of, encrypt, is_receiver, origin_of, text_of
from app.people.access.secret_box import SecretBox
from tests.support.push_services import Browser, claims_of

NOW = datetime(2026, 11, 27, 12, tzinfo=UTC)


def test_example_of_rfc_8291_gives_its_message():
    sender = ec.derive_private_key(int.from_bytes(bytes_of("yfWPiYE-n46HLnH0KqZOF1fJJU3MYrct3AELtAQ-oRw")), CURVE)
    receiver = Receiver(
        bytes_of("BCVxsr7N_eNgVRqvHtD0zTZsEc6-VV-JvLexhqUzORcxaOzi6-AYWXvTBHm4bjyPjs7Vd8pZGH6SRpkNtoIAiw4"),
        bytes_of("BTBZMqHH6r4Tts7J_aSIgg"),
    )
    content = b"When I grow up, I want to be a watermelon"
    message = encrypt(content, receiver, sender=sender, salt=bytes_of("DGv6ra1nlYgDCS1FRnbzlw"))
    assert text_of(message) == (
        "DGv6ra1nlYgDCS1FRnbzlwAAEABBBP4z9KsN6nGRTbVYI_c7VJSPQTBtkgcy27mlmlMoZIIgDll6e3vCYLocInmYWAmS6TlzAC8wEqKK6PBru3jl7A_"
        "yl95bQpu6cVPTpK4Mqgkf1CXztLVBSt2Ks3oZwbuwXPXLWyouBWLVWGNWQexSgSxsj_Qulcy4a-fN"
    )


def test_only_the_receiver_can_read_a_message_and_keys_that_are_none_are_refused():
    browser, other = Browser(), Browser()
    message = encrypt(b"content", browser.receiver)
    assert browser.read(message) == b"content"
    assert b"content" not in message
    assert message != encrypt(b"content", browser.receiver)
    with pytest.raises(InvalidTag):
        other.read(message)
    browser = Browser()
    key, auth = browser.receiver.public_key, browser.receiver.auth
    assert is_receiver(key, auth)
    assert not is_receiver(key[:-1], auth)
    assert not is_receiver(b"\x04" + bytes(64), auth)
    assert not is_receiver(b"\x02" + key[1:33], auth)
    assert not is_receiver(key, auth[:-1])
    with pytest.raises(ValueError, match=r"."):
        encrypt(b"", Receiver(b"\x04" + bytes(64), auth))


def test_key_is_the_same_for_all_processes_of_a_secret_key_and_no_other():
    public = [VapidKey(SecretBox(key * 32)).public_key for key in "aab"]
    assert public[0] == public[1] != public[2]
    assert len(bytes_of(public[0])) == 65


def test_header_proves_the_sender_to_this_push_service_for_a_day_at_most():
    key = VapidKey(SecretBox("k" * 32))
    header = key.authorization(origin_of("https://push.example.org:8443/send/abc?x=1"), "mailto:me@example.org", NOW)
    claims = claims_of(header)
    assert (claims["aud"], claims["sub"]) == ("https://push.example.org:8443", "mailto:me@example.org")
    assert NOW < datetime.fromtimestamp(claims["exp"], UTC) <= NOW + timedelta(hours=24)
    forged = header.replace(text_of(json.dumps({"typ": "JWT", "alg": "ES256"}).encode()), text_of(b"{}"))
    with pytest.raises(InvalidSignature):
        claims_of(forged)
