"""A push service and a browser behind it, for tests: reads messages as RFC 8291 says, and checks who sent them."""

import json
import os

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from app.extras.reminders.web_push import CURVE, Receiver, bytes_of


class Browser:
    """A subscription with its private key."""

    def __init__(self):
        self._key = ec.generate_private_key(CURVE)
        point = self._key.public_key().public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)
        self.receiver = Receiver(point, os.urandom(16))

    def read(self, message):
        """The content of a message. Raises InvalidTag if it is not for this browser."""
        salt, length = message[:16], message[20]
        assert int.from_bytes(message[16:20]) >= len(message) - 21 - length
        sender, sealed = message[21 : 21 + length], message[21 + length :]
        shared = self._key.exchange(ec.ECDH(), ec.EllipticCurvePublicKey.from_encoded_point(CURVE, sender))
        info = b"WebPush: info\0" + self.receiver.public_key + sender
        secret = HKDF(hashes.SHA256(), 32, self.receiver.auth, info).derive(shared)
        key = HKDF(hashes.SHA256(), 16, salt, b"Content-Encoding: aes128gcm\0").derive(secret)
        nonce = HKDF(hashes.SHA256(), 12, salt, b"Content-Encoding: nonce\0").derive(secret)
        content, end = (padded := AESGCM(key).decrypt(nonce, sealed, None))[:-1], padded[-1]
        assert end == 2
        return content


def claims_of(authorization):
    """The claims of a VAPID header. Raises InvalidSignature unless the key in it signed them."""
    scheme, token, key = authorization.replace("t=", "").replace("k=", "").split(" ")
    assert scheme == "vapid"
    signed, _, signature = token.rstrip(",").rpartition(".")
    r, s = (int.from_bytes(half) for half in (bytes_of(signature)[:32], bytes_of(signature)[32:]))
    public = ec.EllipticCurvePublicKey.from_encoded_point(CURVE, bytes_of(key))
    public.verify(encode_dss_signature(r, s), signed.encode(), ec.ECDSA(hashes.SHA256()))
    header, claims = (json.loads(bytes_of(part)) for part in signed.split("."))
    assert header == {"typ": "JWT", "alg": "ES256"}
    return claims
