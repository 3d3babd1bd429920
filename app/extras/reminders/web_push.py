"""Web Push: a message that only one browser can read (RFC 8291), and the proof of who sends it (VAPID, RFC 8292).

The push service sees neither the content nor the study: only the size, the time and the server's public key.
"""

import base64
import json
import os
from dataclasses import dataclass
from datetime import datetime, timedelta
from urllib.parse import urlsplit

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from app.people.access.secret_box import SecretBox

CURVE = ec.SECP256R1()
ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551  # of the curve's base point (SEC 2)
POINT_BYTES, AUTH_BYTES, SALT_BYTES, NUMBER_BYTES = 65, 16, 16, 32
RECORD_BYTES = 4096  # one record holds all
TOKEN_VALID = timedelta(hours=12)  # RFC 8292 allows 24


@dataclass(frozen=True, slots=True)
class Receiver:
    """A browser's subscription: its public key, an uncompressed point of P-256, and its shared secret."""

    public_key: bytes
    auth: bytes


class VapidKey:
    """The server's key, by which a push service knows it again. Derived from the secret key: it is stored nowhere."""

    def __init__(self, box: SecretBox) -> None:
        # 512 bits, so no value is likelier
        drawn = int(box.digest("vapid", "high") + box.digest("vapid", "low"), 16)
        self._key = ec.derive_private_key(drawn % (ORDER - 1) + 1, CURVE)

    @property
    def public_key(self) -> str:
        """The public key as browsers take it for `applicationServerKey`."""
        return text_of(_point(self._key.public_key()))

    def authorization(self, service: str, contact: str, now: datetime) -> str:
        """Return the header `Authorization` of messages to a push service (RFC 8292).

        service: its origin. contact: a mailto: or https: address.
        """
        claims = {
            "aud": service,
            "exp": int((now + TOKEN_VALID).timestamp()),
            "sub": contact,
        }
        signed = ".".join(
            text_of(json.dumps(part).encode()) for part in ({"typ": "JWT", "alg": "ES256"}, claims)
        )
        r, s = decode_dss_signature(self._key.sign(signed.encode(), ec.ECDSA(hashes.SHA256())))
        signature = text_of(r.to_bytes(NUMBER_BYTES) + s.to_bytes(NUMBER_BYTES))
        return f"vapid t={signed}.{signature}, k={self.public_key}"


def origin_of(endpoint: str) -> str:
    """Return the push service of an endpoint, such as https://push.example.org."""
    parts = urlsplit(endpoint)
    return f"{parts.scheme}://{parts.netloc}"


def encrypt(
    content: bytes,
    receiver: Receiver,
    *,
    sender: ec.EllipticCurvePrivateKey | None = None,
    salt: bytes | None = None,
) -> bytes:
    """Return the body of a message, in the coding `aes128gcm` (RFC 8188), with the key agreement of RFC 8291.

    sender, salt: drawn for this message; given in tests only. Raises ValueError if the receiver's key is no point.
    """
    sender, salt = sender or ec.generate_private_key(CURVE), salt or os.urandom(SALT_BYTES)
    sender_point = _point(sender.public_key())
    shared = sender.exchange(
        ec.ECDH(), ec.EllipticCurvePublicKey.from_encoded_point(CURVE, receiver.public_key)
    )
    secret = _derive(
        shared, receiver.auth, b"WebPush: info\0" + receiver.public_key + sender_point, 32
    )
    key = _derive(secret, salt, b"Content-Encoding: aes128gcm\0", 16)
    nonce = _derive(secret, salt, b"Content-Encoding: nonce\0", 12)
    sealed = AESGCM(key).encrypt(nonce, content + b"\x02", None)  # 2: the last record
    return salt + RECORD_BYTES.to_bytes(4) + bytes([POINT_BYTES]) + sender_point + sealed


def is_receiver(public_key: bytes, auth: bytes) -> bool:
    """Return whether these are a point of the curve and a secret of the right length."""
    try:
        ec.EllipticCurvePublicKey.from_encoded_point(CURVE, public_key)
    except ValueError:
        return False
    return len(public_key) == POINT_BYTES and len(auth) == AUTH_BYTES


def text_of(content: bytes) -> str:
    """Encode bytes as base64url without padding."""
    return base64.urlsafe_b64encode(content).rstrip(b"=").decode()


def bytes_of(text: str) -> bytes:
    """Decode base64url with or without padding. Raises ValueError."""
    return base64.b64decode(
        text.rstrip("=") + "=" * (-len(text.rstrip("=")) % 4), altchars=b"-_", validate=True
    )


def _derive(secret: bytes, salt: bytes, info: bytes, length: int) -> bytes:
    return HKDF(hashes.SHA256(), length=length, salt=salt, info=info).derive(secret)


def _point(key: ec.EllipticCurvePublicKey) -> bytes:
    return key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)
