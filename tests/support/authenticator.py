"""An app that shows codes, by RFC 4226 and RFC 6238 alone."""

import base64
import hashlib
import hmac


def code_of(secret, step):
    """The six digits of a secret in base32 in a time step."""
    digest = hmac.new(base64.b32decode(secret), step.to_bytes(8), hashlib.sha1).digest()
    start = digest[-1] & 15
    return f"{(int.from_bytes(digest[start : start + 4]) & 0x7FFFFFFF) % 10**6:06}"
