"""One HTTP POST to a webhook's receiver, at a checked address and within a total time.

The connection goes to the checked address, while `Host`, SNI and certificate verification use the name. Redirects and
proxies of the environment are ignored; of the response, only status and headers count. Many POSTs can share
connections.
"""

import asyncio
import ssl
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import TypeVar, cast

import anyio
import anyio.to_thread
import httpx2

from app.webhooks.safe_address import AddressError, Resolver, Target, parse_target, resolve_safely

TOTAL_SECONDS = 10.0  # for look-up, connecting, handshake, sending and the response's head together
STEP_SHARE = 0.9  # of the total time, for one step
MAX_HEADERS = 100  # a response with more is refused
MAX_CONNECTIONS, MAX_KEPT_CONNECTIONS = 100, 20  # the first: more than POSTs are sent at once
MAX_LOOKUPS = 64  # at once; at least as many as POSTs are sent at once, so that a slow look-up delays no other
MAX_BODY_BYTES = (
    16 * 1024
)  # of a response whose connection is kept; after a longer one it is closed
BODY_SECONDS = 1.0  # for the body of such a response; after a slower one the connection is closed

ErrorT = TypeVar("ErrorT", bound=BaseException)


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of a POST. status: of the response; None if there was none; error then says why."""

    status: int | None
    error: str | None = None
    retry_after_seconds: float | None = None

    @property
    def is_success(self) -> bool:
        """Return whether the receiver accepted the delivery."""
        return self.status is not None and 200 <= self.status < 300


AsyncSend = Callable[[str, Mapping[str, str], bytes], Awaitable[Answer]]


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

        async def send_alone() -> Answer:
            async with self.kept_connections() as send:
                return await send(url, {**headers, "Connection": "close"}, body)

        return asyncio.run(send_alone())

    @asynccontextmanager
    async def kept_connections(self) -> AsyncIterator[AsyncSend]:
        """Yield a coroutine that POSTs as `send` does, many at once, by connections that are kept until the end.

        A host's addresses are resolved and checked once; after a failure the next POST tries again.
        """
        limits = httpx2.Limits(
            max_connections=MAX_CONNECTIONS, max_keepalive_connections=MAX_KEPT_CONNECTIONS
        )
        transport = self._transport or httpx2.AsyncHTTPTransport(
            verify=self._tls, trust_env=False, limits=limits
        )
        async with transport:
            yield partial(self._send, transport, _Lookups(self._resolve_safely))

    async def _send(
        self,
        transport: httpx2.AsyncBaseTransport,
        lookups: "_Lookups",
        url: str,
        headers: Mapping[str, str],
        body: bytes,
    ) -> Answer:
        try:
            target = parse_target(url, allow_loopback=self._allow_loopback)
            async with asyncio.timeout(self._total_seconds):
                addresses = await lookups.addresses_of(target)
                if lookups.are_of_another_name(target, addresses):
                    async with self.kept_connections() as send_alone:
                        return await send_alone(url, headers, body)
                requests = [self._request(target, address, headers, body) for address in addresses]
                try:
                    response = await _send_to_first(transport, requests)
                except (httpx2.ReadError, httpx2.WriteError, httpx2.RemoteProtocolError):
                    # a kept connection may end before it has answered: it had been idle
                    response = await _send_to_first(transport, requests)
        except (AddressError, TimeoutError, httpx2.TransportError) as error:
            return self._failure(error)
        await _end_body(response)
        return _answer(response)

    def _resolve_safely(self, target: Target) -> tuple[str, ...]:
        return resolve_safely(target, allow_loopback=self._allow_loopback, resolve=self._resolve)

    def _failure(self, error: AddressError | TimeoutError | httpx2.TransportError) -> Answer:
        if isinstance(error, AddressError):
            return Answer(None, error.message)
        if isinstance(error, (TimeoutError, httpx2.TimeoutException)):
            return Answer(None, f"No answer within {self._total_seconds:g} seconds.")
        if isinstance(error, httpx2.ProtocolError):
            return Answer(None, "The answer was not HTTP.")
        return Answer(None, _why_not_connected(error))

    def _request(
        self, target: Target, address: str, headers: Mapping[str, str], body: bytes
    ) -> httpx2.Request:
        host = f"[{address}]" if ":" in address else address
        # per step, so that the library itself ends a stalled step and closes the connection
        timeouts = dict.fromkeys(
            ("connect", "read", "write", "pool"), STEP_SHARE * self._total_seconds
        )
        return httpx2.Request(
            "POST",
            f"{target.scheme}://{host}:{target.port}{target.path}",
            headers={"Host": target.host_header, "Content-Length": str(len(body)), **headers},
            content=body,
            extensions={"sni_hostname": target.host, "timeout": timeouts},
        )


class _Lookups:
    """The checked addresses of hosts, each looked up once, and whose connections are kept to which address."""

    def __init__(self, resolve_safely: Callable[[Target], tuple[str, ...]]) -> None:
        self._resolve_safely = resolve_safely
        self._threads = anyio.CapacityLimiter(MAX_LOOKUPS)
        self._locks: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._addresses: dict[str, tuple[str, ...]] = {}  # by host
        self._hosts: dict[tuple[str, int], str] = {}  # by address and port

    async def addresses_of(self, target: Target) -> tuple[str, ...]:
        """Return the target's addresses. Raises AddressError."""
        async with self._locks[target.host]:
            if target.host not in self._addresses:
                self._addresses[target.host] = await anyio.to_thread.run_sync(
                    self._resolve_safely, target, abandon_on_cancel=True, limiter=self._threads
                )
        return self._addresses[target.host]

    def are_of_another_name(self, target: Target, addresses: tuple[str, ...]) -> bool:
        """Whether a connection to one of them may have the certificate of another name."""
        hosts = [self._hosts.setdefault((each, target.port), target.host) for each in addresses]
        return set(hosts) != {target.host}


async def _send_to_first(
    transport: httpx2.AsyncBaseTransport, requests: Sequence[httpx2.Request]
) -> httpx2.Response:
    """Send to the first address that accepts a connection."""
    *others, last = requests
    for request in others:
        try:
            return await transport.handle_async_request(request)
        except httpx2.ConnectError as error:
            if _cause(error, ssl.SSLError) is not None:
                raise
    return await transport.handle_async_request(last)


async def _end_body(response: httpx2.Response) -> None:
    """Read the body, so that the connection can be used again; close it if the body is long, slow or cut."""
    size = 0
    try:
        with suppress(TimeoutError, httpx2.TransportError):
            async with asyncio.timeout(BODY_SECONDS):
                async for part in cast("httpx2.AsyncByteStream", response.stream):
                    size += len(part)
                    if size > MAX_BODY_BYTES:
                        return
    finally:
        await response.aclose()


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
    return (
        float(retry_after)
        if retry_after is not None and retry_after.isascii() and retry_after.isdigit()
        else None
    )
