"""One HTTP POST to a webhook's receiver, at a checked address and within a total time.

The connection goes to the checked address, while `Host`, SNI and certificate verification use the name. Redirects and
proxies of the environment are ignored; of the response, only status and headers count. Many POSTs to few hosts can
share connections.
"""

import asyncio
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import TypeVar, cast

import h11
import httpx2

from app.webhooks.safe_address import AddressError, Resolver, Target, parse_target, resolve_safely

TOTAL_SECONDS = 10.0  # for connecting, handshake, sending and the response's head together
STEP_SHARE = 0.9  # of the total time, for one step
MAX_HEADERS = 100  # a response with more is refused
# To more hosts each POST has a connection of its own: whoever names hosts cannot hold many connections open.
KEPT_HOSTS = 20
MAX_CONNECTIONS = 100  # to one host
MAX_LOOKUPS = 64  # at once; at least as many as POSTs are sent at once, so that a slow look-up delays no other
MAX_BODY_BYTES = 16 * 1024  # of a response whose connection is kept; after a longer one it is closed
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


@dataclass(frozen=True, slots=True)
class _Post:
    """A body with its headers for a target, whose addresses were checked."""

    target: Target
    addresses: tuple[str, ...]
    headers: Mapping[str, str]
    body: bytes


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
        try:
            target = parse_target(url, allow_loopback=self._allow_loopback)
            addresses = resolve_safely(target, allow_loopback=self._allow_loopback, resolve=self._resolve)
            return asyncio.run(self._send_alone(_Post(target, addresses, headers, body)))
        except (AddressError, TimeoutError, httpx2.TransportError) as error:
            return self._failure(error)

    @asynccontextmanager
    async def kept_connections(self) -> AsyncIterator[AsyncSend]:
        """Yield a coroutine that POSTs as `send` does, many at once, by connections that are kept until the end.

        A host's addresses are resolved and checked once; after a failure the next POST tries again.
        """
        async with AsyncExitStack() as stack:
            threads = ThreadPoolExecutor(MAX_LOOKUPS, thread_name_prefix="look-up")
            stack.callback(threads.shutdown, wait=False, cancel_futures=True)
            lookups: dict[str, asyncio.Task[tuple[str, ...]]] = {}  # by host; successful or under way
            transports: dict[str, httpx2.AsyncBaseTransport] = {}  # by host

            async def look_up(host: str, target: Target) -> tuple[str, ...]:
                def drop_failure(lookup: asyncio.Task[tuple[str, ...]]) -> None:
                    if lookup.cancelled() or lookup.exception() is not None:
                        del lookups[host]

                if host not in lookups:
                    lookups[host] = asyncio.create_task(self._resolve_in(threads, target))
                    lookups[host].add_done_callback(drop_failure)
                return await asyncio.shield(lookups[host])

            async def send(url: str, headers: Mapping[str, str], body: bytes) -> Answer:
                try:
                    target = parse_target(url, allow_loopback=self._allow_loopback)
                    host = f"{target.scheme}://{target.host}:{target.port}"
                    async with asyncio.timeout(self._total_seconds):
                        post = _Post(target, await look_up(host, target), headers, body)
                        response = None
                        if host not in transports and len(transports) < KEPT_HOSTS:
                            transports[host] = self._open_transport()
                            await stack.enter_async_context(transports[host])
                        if host in transports:
                            response = await self._send_kept(transports[host], post)
                        if response is None:
                            return await self._send_alone(post)
                except (AddressError, TimeoutError, httpx2.TransportError) as error:
                    return self._failure(error)
                await _end_body(response)
                return _answer(response)

            yield send

    async def _resolve_in(self, threads: ThreadPoolExecutor, target: Target) -> tuple[str, ...]:
        resolve = partial(resolve_safely, target, allow_loopback=self._allow_loopback, resolve=self._resolve)
        return await asyncio.get_running_loop().run_in_executor(threads, resolve)

    async def _send_kept(self, transport: httpx2.AsyncBaseTransport, post: _Post) -> httpx2.Response | None:
        """Return the response, or None if the peer ended a kept connection before it answered: it had been idle.

        httpx2 does not say whether a part of the response's head had arrived.
        """
        is_new = False

        async def note_connection(event: str, _: object) -> None:
            nonlocal is_new
            is_new = is_new or event == "connection.connect_tcp.complete"

        try:
            return await self._send_by(transport, post, {"trace": note_connection})
        except (httpx2.ReadError, httpx2.WriteError, httpx2.RemoteProtocolError) as error:
            if is_new or _cause(error, h11.RemoteProtocolError) is not None:
                raise
            return None

    async def _send_alone(self, post: _Post) -> Answer:
        closing = replace(post, headers={**post.headers, "Connection": "close"})
        async with asyncio.timeout(self._total_seconds), self._open_transport() as transport:
            response = await self._send_by(transport, closing)
            await response.aclose()  # without reading the body
            return _answer(response)

    async def _send_by(
        self, transport: httpx2.AsyncBaseTransport, post: _Post, extensions: Mapping[str, object] = MappingProxyType({})
    ) -> httpx2.Response:
        """Send to the first address that accepts a connection. extensions: of the request, for httpx2."""
        for number, address in enumerate(post.addresses, 1):
            try:
                return await transport.handle_async_request(self._request(post, address, extensions))
            except httpx2.ConnectError as error:
                if number == len(post.addresses) or _cause(error, ssl.SSLError) is not None:
                    raise
        raise AddressError("The name in the URL does not resolve.")

    def _failure(self, error: AddressError | TimeoutError | httpx2.TransportError) -> Answer:
        if isinstance(error, AddressError):
            return Answer(None, error.message)
        if isinstance(error, (TimeoutError, httpx2.TimeoutException)):
            return Answer(None, f"No answer within {self._total_seconds:g} seconds.")
        if isinstance(error, httpx2.ProtocolError):
            return Answer(None, "The answer was not HTTP.")
        return Answer(None, _why_not_connected(error))

    def _open_transport(self) -> httpx2.AsyncBaseTransport:
        return self._transport or httpx2.AsyncHTTPTransport(
            verify=self._tls, trust_env=False, retries=0, limits=httpx2.Limits(max_connections=MAX_CONNECTIONS)
        )

    def _request(self, post: _Post, address: str, extensions: Mapping[str, object]) -> httpx2.Request:
        target, host = post.target, f"[{address}]" if ":" in address else address
        return httpx2.Request(
            "POST",
            f"{target.scheme}://{host}:{target.port}{target.path}",
            headers={"Host": target.host_header, "Content-Length": str(len(post.body)), **post.headers},
            content=post.body,
            extensions={
                "sni_hostname": target.host,
                # per step, so that the library itself ends a stalled step and closes the connection
                "timeout": dict.fromkeys(("connect", "read", "write", "pool"), STEP_SHARE * self._total_seconds),
                **extensions,
            },
        )


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
    return float(retry_after) if retry_after is not None and retry_after.isascii() and retry_after.isdigit() else None
