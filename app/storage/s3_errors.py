"""What a failed call to an S3 store means: obstore's error text in -> an OSError that says whether waiting helps.

obstore has no types for most of these, so its text is read for the S3 error code and for the kind of fault, which
tests/integration/storage/test_stores.py provokes with a real server. The text itself goes no further: it holds keys of
blobs, addresses and whatever the server answered.
"""

import errno
import re

from app.storage.blob_store import StoreRefusesError

CODE = re.compile(r"<Code>(\w+)</Code>")
STATUS = re.compile(r"non-2xx status code: (\d{3})")
FAULT = re.compile(r"kind: (Timeout|Connect)\b")
MACHINE_ROLE = "169.254.169.254"  # where AWS machines ask for keys when none are set

FULL_CODES = frozenset({"XMinioStorageFull", "XMinioAdminBucketQuotaExceeded", "QuotaExceeded", "InsufficientStorage"})
REGION_CODES = frozenset({"PermanentRedirect", "AuthorizationHeaderMalformed", "IllegalLocationConstraintException"})


def is_missing(said: str) -> bool:
    """Whether there is no such object, though there is a bucket."""
    return _status(said) == "404" and _code(said) != "NoSuchBucket"


def is_empty_range(said: str) -> bool:
    """Whether the object has no such bytes."""
    return _status(said) == "416"


def store_error(said: str, place: object) -> OSError:
    """The error to raise. place: for the log; the words about the fault name no address, since /readyz tells them."""
    code, status = _code(said), _status(said)
    named = f" ({code})" if code else ""
    fault = FAULT.search(said)
    if MACHINE_ROLE in said:
        return _refusal("no key is set, and this machine has no role that gives one", place)
    if code == "NoSuchBucket":
        return _refusal("the bucket is not there", place)
    if code in REGION_CODES or "configured region" in said:
        return _refusal("the bucket is in another region than TADA_S3_REGION says", place)
    if status in ("401", "403"):
        return _refusal(f"the file store refuses our key{named}", place)
    if code in FULL_CODES or status == "507":
        return OSError(errno.ENOSPC, f"the file store is full{named}", str(place))
    if fault is not None and fault[1] == "Connect":
        return OSError(errno.ECONNREFUSED, "the file store cannot be reached", str(place))
    if fault is not None:
        return OSError(errno.ETIMEDOUT, "the file store does not answer in time", str(place))
    return OSError(
        errno.EIO, f"the file store answers with an error{named or (f' ({status})' if status else '')}", str(place)
    )


def _refusal(words: str, place: object) -> StoreRefusesError:
    return StoreRefusesError(errno.EIO, words, str(place))


def _code(said: str) -> str | None:
    found = CODE.search(said)
    return found[1] if found else None


def _status(said: str) -> str | None:
    found = STATUS.search(said)
    return found[1] if found else None
