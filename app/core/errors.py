"""The hierarchy of errors, each with a stable code and HTTP status; and Failure, a scene's expected failure as a value.

A bad call or request raises a TadaError, which app/http/problems.py renders as RFC 9457. A
photograph that cannot be measured is a result, not an error: a `Failure` is returned, stored with
the meal and shown to people.
"""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Failure:
    """The reason why a scene could not be measured: a stable code, a message, and advice for the next attempt."""

    code: str
    message: str
    advice: str = ""

    def __bool__(self) -> bool:
        """Return False, so that `if not result` is true for a failure."""
        return False


class TadaError(Exception):
    """Base of all reported errors: `code` never changes its meaning; `facts` are added to the problem document."""

    code: ClassVar[str] = "internal_error"
    status: ClassVar[int] = 500
    retryable: ClassVar[bool] = False

    def __init__(self, message: str, *, code: str | None = None, **facts: object) -> None:
        super().__init__(message)
        self.message = message
        self.facts = facts
        if code is not None:
            self.code = code  # type: ignore[misc]  # a subclass may carry several codes of one status


class InvalidInputError(TadaError):
    """The request is understood but a value in it cannot be accepted."""

    code = "invalid_input"
    status = 422


class MalformedRequestError(TadaError):
    """The request cannot be parsed (broken multipart, broken JSON, a missing part)."""

    code = "malformed_request"
    status = 400


class UnauthenticatedError(TadaError):
    """No token, or one that is unknown, expired or revoked."""

    code = "unauthenticated"
    status = 401


class NotAllowedError(TadaError):
    """The caller is known and may see the resource, but may not do this."""

    code = "not_allowed"
    status = 403


class NotFoundError(TadaError):
    """The resource does not exist, or the caller may not know that it exists."""

    code = "not_found"
    status = 404


class NotAcceptableError(TadaError):
    """The resource is not available in any format that the caller accepts."""

    code = "not_acceptable"
    status = 406


class ConflictError(TadaError):
    """The id is in use, or the current state does not allow the request."""

    code = "conflict"
    status = 409


class ClockDiffersError(ConflictError):
    """The caller's clock differs from the server's: `facts["server_time"]` is the server's time."""

    code = "clock_differs"
    retryable = True  # the server's clock may be the wrong one


class GoneError(TadaError):
    """The resource existed and has been deleted for good."""

    code = "gone"
    status = 410


class PreconditionFailedError(TadaError):
    """The resource has changed since the caller read it: `If-Match` names an older version."""

    code = "precondition_failed"
    status = 412


class RequestTimeoutError(TadaError):
    """The caller sent the request too slowly; nothing was stored."""

    code = "body_too_slow"
    status = 408
    retryable = True


class PreconditionRequiredError(TadaError):
    """The change requires `If-Match` with the version that it applies to."""

    code = "precondition_required"
    status = 428


class TooLargeError(TadaError):
    """A body, a part or a picture exceeds a limit; `facts` name the limit."""

    code = "too_large"
    status = 413


class UnsupportedMediaError(TadaError):
    """The server does not read this content type, or the format that the bytes have."""

    code = "unsupported_media_type"
    status = 415


class RangeNotSatisfiableError(TadaError):
    """The requested range is outside the file; `facts["length"]` is its length."""

    code = "range_not_satisfiable"
    status = 416


class RateLimitedError(TadaError):
    """Too many calls; `facts["retry_after_seconds"]` is the time to wait."""

    code = "rate_limited"
    status = 429
    retryable = True


class UnavailableError(TadaError):
    """A service that the request needs is temporarily unavailable; nothing was stored."""

    code = "unavailable"
    status = 503
    retryable = True


class StorageFullError(TadaError):
    """The disk is full; nothing was stored, so the phone keeps its copy and tries again."""

    code = "storage_full"
    status = 503
    retryable = True
