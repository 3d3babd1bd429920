"""Translate obstore's error text to an OSError, whose errno tells whether waiting helps.

obstore has no types for most errors, so its text is parsed for the S3 error code and the kind of fault, which
tests/integration/storage/test_stores.py provokes with a real server. The text itself is dropped: it contains keys of
blobs, addresses and the server's response.
"""

import errno
import re

from app.storage.blob_store import StoreRefusesError

CODE = re.compile(r"<Code>(\w+)</Code>")
STATUS = re.compile(r"non-2xx status code: (\d{3})")
FAULT = re.compile(r"kind: (Timeout|Connect)\b")
MACHINE_ROLE = "169.254.169.254"  # where AWS machines request keys if none are set

FULL_CODES = frozenset(
    {"XMinioStorageFull", "XMinioAdminBucketQuotaExceeded", "QuotaExceeded", "InsufficientStorage"}
)
REGION_CODES = frozenset(
    {"PermanentRedirect", "AuthorizationHeaderMalformed", "IllegalLocationConstraintException"}
)


def is_missing(text: str) -> bool:
    """Return whether the object is missing, but not the bucket."""
    return _status(text) == "404" and _code(text) != "NoSuchBucket"


def is_empty_range(text: str) -> bool:
    """Return whether the object does not have the requested bytes."""
    return _status(text) == "416"


def store_error(text: str, place: object) -> OSError:
    """Return the error to raise. place: for the log; the message contains no address, since /readyz shows it."""
    code, status = _code(text), _status(text)
    code_suffix = f" ({code})" if code else ""
    fault = FAULT.search(text)
    if MACHINE_ROLE in text:
        return _refusal("no key is set, and this machine has no role that provides one", place)
    if code == "NoSuchBucket":
        return _refusal("the bucket is not there", place)
    if code in REGION_CODES or "configured region" in text:
        return _refusal("the bucket is in another region than TADA_S3_REGION says", place)
    if status in ("401", "403"):
        return _refusal(f"the file store refuses our key{code_suffix}", place)
    if code in FULL_CODES or status == "507":
        return OSError(errno.ENOSPC, f"the file store is full{code_suffix}", str(place))
    if fault is not None and fault[1] == "Connect":
        return OSError(errno.ECONNREFUSED, "the file store cannot be reached", str(place))
    if fault is not None:
        return OSError(errno.ETIMEDOUT, "the file store does not answer in time", str(place))
    return OSError(
        errno.EIO,
        f"the file store answers with an error{code_suffix or (f' ({status})' if status else '')}",
        str(place),
    )


def _refusal(message: str, place: object) -> StoreRefusesError:
    return StoreRefusesError(errno.EIO, message, str(place))


def _code(text: str) -> str | None:
    match = CODE.search(text)
    return match[1] if match else None


def _status(text: str) -> str | None:
    match = STATUS.search(text)
    return match[1] if match else None
