"""The tree of errors, each with its stable code and HTTP status; and Failure, a scene's expected failure as a value.

A bad call or a bad request raises a TadaError; app/http/problems.py renders it once, as RFC 9457. A photograph that
cannot be measured is no error but an answer: a `Failure` that is returned, stored with the meal and shown to a person.
"""

from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a scene could not be measured: a stable code, words for a person, and what to do on the next try."""

    code: str
    message: str
    advice: str = ""

    def __bool__(self) -> bool:
        """A failed result is falsy, so that `if not found` reads as it should."""
        return False


class TadaError(Exception):
    """Root of what the server reports: `code` never changes its meaning; `facts` are added to the problem document."""

    code: ClassVar[str] = "internal_error"
    status: ClassVar[int] = 500
    retryable: ClassVar[bool] = False

    def __init__(self, message: str, *, code: str | None = None, **facts: Any) -> None:
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
    """There is no such thing, or the caller may not know that there is."""

    code = "not_found"
    status = 404


class NotAcceptableError(TadaError):
    """None of the formats that the caller would take is one that this is given in."""

    code = "not_acceptable"
    status = 406


class ConflictError(TadaError):
    """The id is taken by something else, or the state does not allow this."""

    code = "conflict"
    status = 409


class ClockDiffersError(ConflictError):
    """The caller's clock and ours cannot both be right: `facts["server_time"]` says what ours is."""

    code = "clock_differs"
    retryable = True  # it may be ours that is wrong


class GoneError(TadaError):
    """It was there and has been deleted for good."""

    code = "gone"
    status = 410


class PreconditionFailedError(TadaError):
    """It has changed since the caller read it: what `If-Match` names is not its state any more."""

    code = "precondition_failed"
    status = 412


class RequestTimeoutError(TadaError):
    """The caller was too slow in sending the request; nothing of it was kept."""

    code = "request_timeout"
    status = 408
    retryable = True


class TargetTooLongError(TadaError):
    """The request's address is longer than any of ours."""

    code = "target_too_long"
    status = 414


class HeadersTooLargeError(TadaError):
    """The request has too many headers, or too large ones."""

    code = "headers_too_large"
    status = 431


class PreconditionRequiredError(TadaError):
    """A change that must say what it is a change of, in `If-Match`."""

    code = "precondition_required"
    status = 428


class TooLargeError(TadaError):
    """A body, a part or a picture passes a limit; `facts` name the limit."""

    code = "too_large"
    status = 413


class UnsupportedMediaError(TadaError):
    """The content type, or what the bytes turn out to be, is none that the server reads."""

    code = "unsupported_media_type"
    status = 415


class RangeNotSatisfiableError(TadaError):
    """A part of a file is asked for that it does not have; `facts["length"]` is how long it is."""

    code = "range_not_satisfiable"
    status = 416


class RateLimitedError(TadaError):
    """Too many calls; `facts["retry_after_seconds"]` says when to come back."""

    code = "rate_limited"
    status = 429
    retryable = True


class UnavailableError(TadaError):
    """A part that the request needs is out of service for now; nothing was kept."""

    code = "unavailable"
    status = 503
    retryable = True


class StorageFullError(TadaError):
    """The disk has no room; nothing was kept, the phone keeps its copy and tries again."""

    code = "storage_full"
    status = 503
    retryable = True
