"""One HTTP POST to a webhook's receiver, at a checked address and within a total time.

The connection goes to the checked address, while `Host`, SNI and certificate verification use the name. Redirects and
proxies of the environment are ignored, and the response's body is not read: only status and headers count.
"""

import asyncio
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import httpx2

from app.webhooks.safe_address import AddressError, Resolver, Target, parse_target, resolve_safely

TOTAL_SECONDS = 10.0  # for connecting, handshake, sending and the response's head together
STEP_SHARE = 0.9  # of the total time, for one step
MAX_HEADERS = 100  # a response with more is refused

ErrorT = TypeVar("ErrorT", bound=BaseException)


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of a POST. status: of the response; None if there was none, and error tells why."""

    status: int | None
    error: str | None = None
    retry_after_seconds: float | None = None

    @property
    def is_success(self) -> bool:
        """Whether the receiver accepted the delivery."""
        return self.status is not None and 200 <= self.status < 300


class WebhookPost:
    """Sends; one per process, safe to share between threads. resolve, tls, transport: replaced in tests."""

    def __init__(
        self,
        *,
        allow_loopback: bool,
        total_seconds: float = TOTAL_SECONDS,
        resolve: Resolver | None = None,
        tls: ssl.SSLContext | None = None,
        transport: httpx2.AsyncBaseTransport | None = None,
    ) -> None:
        self._allow_loopback = allow_loopback
        self._total_seconds = total_seconds
        self._resolve = resolve
        self._tls = tls or ssl.create_default_context()
        self._transport = transport

    def send(self, url: str, headers: Mapping[str, str], body: bytes) -> Answer:
        """POST the body. Failures of the receiver or the network are returned, not raised."""
        try:
            target = parse_target(url, allow_loopback=self._allow_loopback)
            addresses = resolve_safely(target, allow_loopback=self._allow_loopback, resolve=self._resolve)
            return asyncio.run(self._send_in_time(target, addresses, headers, body))
        except AddressError as error:
            return Answer(None, error.message)
        except (TimeoutError, httpx2.TimeoutException):
            return Answer(None, f"No answer within {self._total_seconds:g} seconds.")
        except httpx2.ProtocolError:
            return Answer(None, "The answer was not HTTP.")
        except httpx2.TransportError as error:
            return Answer(None, _why_not_connected(error))

    async def _send_in_time(
        self, target: Target, addresses: tuple[str, ...], headers: Mapping[str, str], body: bytes
    ) -> Answer:
        """Send to the first address that accepts a connection."""
        async with asyncio.timeout(self._total_seconds), self._open_transport() as transport:
            for number, address in enumerate(addresses, 1):
                try:
                    response = await transport.handle_async_request(self._request(target, address, headers, body))
                except httpx2.ConnectError as error:
                    if number == len(addresses) or _cause(error, ssl.SSLError) is not None:
                        raise
                else:
                    await response.aclose()  # without reading the body
                    return _answer(response)
        raise AddressError("The name in the URL does not resolve.")

    def _open_transport(self) -> httpx2.AsyncBaseTransport:
        return self._transport or httpx2.AsyncHTTPTransport(verify=self._tls, trust_env=False, retries=0)

    def _request(self, target: Target, address: str, headers: Mapping[str, str], body: bytes) -> httpx2.Request:
        host = f"[{address}]" if ":" in address else address
        return httpx2.Request(
            "POST",
            f"{target.scheme}://{host}:{target.port}{target.path}",
            headers={
                "Host": target.host_header,
                "Content-Length": str(len(body)),
                **headers,
                "Connection": "close",
            },
            content=body,
            extensions={
                "sni_hostname": target.host,
                # per step, so that the library itself ends a stalled step and closes the connection
                "timeout": dict.fromkeys(("connect", "read", "write", "pool"), STEP_SHARE * self._total_seconds),
            },
        )


def _answer(response: httpx2.Response) -> Answer:
    if len(response.headers.raw) > MAX_HEADERS:
        return Answer(None, "The answer was not HTTP.")
    return Answer(response.status_code, None, _seconds(response.headers.get("Retry-After")))


def _why_not_connected(error: httpx2.TransportError) -> str:
    certificate = _cause(error, ssl.SSLCertVerificationError)
    if certificate is not None:
        return f"The certificate was not accepted: {certificate.verify_message}."[:200]
    if _cause(error, ssl.SSLError) is not None:
        return "TLS could not be established."
    if _cause(error, ConnectionRefusedError) is not None:
        return "The connection was refused."
    return "The connection failed."


def _cause(error: BaseException, kind: type[ErrorT]) -> ErrorT | None:
    """Return the error of this kind in the chain of causes, or None."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, kind):
        cause = cause.__cause__ or cause.__context__
    return cause


def _seconds(retry_after: str | None) -> float | None:
    """Parse Retry-After in seconds; dates, its other form, are ignored."""
    return float(retry_after) if retry_after is not None and retry_after.isascii() and retry_after.isdigit() else None
