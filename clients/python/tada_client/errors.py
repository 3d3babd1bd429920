"""The errors of a call: Problem if the server refused it, NetworkError if no whole answer came."""

from collections.abc import Mapping

TRANSIENT = frozenset({408, 425, 429, 500, 502, 503, 504})


class Problem(Exception):  # noqa: N818  # RFC 9457's name for it
    """The server's refusal, an RFC 9457 problem document. `code` is stable: docs/errors.md lists all codes.

    document: all of it; further members name the limit, the slot or the field. Empty: a proxy answered, not the server.
    retry_after_seconds: from `Retry-After`; None: the answer has none.
    """

    def __init__(
        self,
        status: int,
        document: Mapping[str, object] | None = None,
        retry_after_seconds: float | None = None,
    ) -> None:
        self.status = status
        self.document = dict(document or {})
        self.code = str(self.document.get("code", "unknown"))
        self.detail = str(self.document.get("detail", f"The server answered {status}."))
        self.retryable = bool(self.document.get("retryable", status in TRANSIENT))
        self.retry_after_seconds = retry_after_seconds
        super().__init__(f"{self.code}: {self.detail}")


class NetworkError(Exception):
    """No whole answer came. What was sent may have arrived."""
