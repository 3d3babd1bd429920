"""One HTTP POST to a webhook's receiver, at a checked address and within a total time.

A pool of connections by names, whose network connects to checked addresses alone: `Host`, SNI and
certificate are those of the URL's name. There are no redirects and no proxies of the environment;
of the response, only status and headers count. Many POSTs can share connections.
"""

import asyncio
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import anyio.to_thread
import httpcore2

from app.webhooks.safe_address import AddressError, Resolver, parse_target, resolve_safely

TOTAL_SECONDS = 10.0  # for look-up, connecting, handshake, sending and the response's head together
STEP_SHARE = 0.9  # of the total time, for one step
MAX_HEADERS = 100  # a response with more is refused
MAX_CONNECTIONS, MAX_KEPT_CONNECTIONS = 100, 20  # the first: more than POSTs are sent at once
# of a response whose connection is kept; after a longer one it is closed
MAX_BODY_BYTES = 16 * 1024
BODY_SECONDS = 1.0  # for the body of such a response; after a slower one the connection is closed
NO_HTTP = "The answer was not HTTP."
BROKEN = (httpcore2.TimeoutException, httpcore2.NetworkError, httpcore2.ProtocolError)

ErrorT = TypeVar("ErrorT", bound=BaseException)


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of a POST.

    status: of the response; None if there was none; error then says why.
    """

    status: int | None
    error: str | None = None
    retry_after_seconds: float | None = None

    @property
    def is_success(self) -> bool:
        """Return whether the receiver accepted the delivery."""
        return self.status is not None and 200 <= self.status < 300


AsyncSend = Callable[[str, Mapping[str, str], bytes], Awaitable[Answer]]


class CheckedNetwork(httpcore2.AnyIOBackend):
    """Connects to the first of a name's checked addresses that accepts.

    addresses_of: name, port -> addresses; raises AddressError
    """

    def __init__(self, addresses_of: Callable[[str, int], tuple[str, ...]]) -> None:
        self._addresses_of = addresses_of

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,  # noqa: ASYNC109  # the library's own parameter
        local_address: str | None = None,
        socket_options: Iterable[httpcore2.SOCKET_OPTION] | None = None,
    ) -> httpcore2.AsyncNetworkStream:
        """Return a connection. Raises AddressError, httpcore2.ConnectError."""
        *others, last = await anyio.to_thread.run_sync(
            self._addresses_of, host, port, abandon_on_cancel=True
        )
        for address in others:
            with suppress(httpcore2.ConnectError):
                return await super().connect_tcp(
                    address, port, timeout, local_address, socket_options
                )
        return await super().connect_tcp(last, port, timeout, local_address, socket_options)


class WebhookPost:
    """Sends; one per process, safe to share between threads. resolve, tls, pool: for tests."""

    def __init__(
        self,
        *,
        allow_loopback: bool,
        total_seconds: float = TOTAL_SECONDS,
        resolve: Resolver | None = None,
        tls: ssl.SSLContext | None = None,
        pool: httpcore2.AsyncConnectionPool | None = None,
    ) -> None:
        self._allow_loopback = allow_loopback
        self._total_seconds = total_seconds
        self._network = CheckedNetwork(
            partial(resolve_safely, allow_loopback=allow_loopback, resolve=resolve)
        )
        self._tls = tls or ssl.create_default_context()
        self._pool = pool

    def send(self, url: str, headers: Mapping[str, str], body: bytes) -> Answer:
        """POST the body. Failures of the receiver or the network are returned, not raised."""

        async def send_alone() -> Answer:
            async with self.kept_connections() as send:
                return await send(url, {**headers, "Connection": "close"}, body)

        return asyncio.run(send_alone())

    @asynccontextmanager
    async def kept_connections(self) -> AsyncIterator[AsyncSend]:
        """Yield a coroutine that POSTs as `send` does, many at once, by connections that are kept."""
        pool = self._pool or httpcore2.AsyncConnectionPool(
            ssl_context=self._tls,
            max_connections=MAX_CONNECTIONS,
            max_keepalive_connections=MAX_KEPT_CONNECTIONS,
            network_backend=self._network,
        )
        async with pool:
            yield partial(self._send, pool)

    async def _send(
        self,
        pool: httpcore2.AsyncConnectionPool,
        url: str,
        headers: Mapping[str, str],
        body: bytes,
    ) -> Answer:
        try:
            request = self._request(url, headers, body)
            async with asyncio.timeout(self._total_seconds):
                try:
                    response = await pool.handle_async_request(request)
                except (httpcore2.ReadError, httpcore2.WriteError, httpcore2.RemoteProtocolError):
                    # a kept connection may end before it has answered: it had been idle
                    response = await pool.handle_async_request(request)
        except AddressError as error:
            return Answer(None, error.message)
        except (TimeoutError, httpcore2.TimeoutException):
            return Answer(None, f"No answer within {self._total_seconds:g} seconds.")
        except httpcore2.ProtocolError:
            return Answer(None, NO_HTTP)
        except httpcore2.NetworkError as error:
            return Answer(None, _why_not_connected(error))
        await _end_body(response)
        return _answer(response)

    def _request(self, url: str, headers: Mapping[str, str], body: bytes) -> httpcore2.Request:
        target = parse_target(url, allow_loopback=self._allow_loopback)
        # per step, so that the library itself ends a stalled step and closes the connection
        timeouts = dict.fromkeys(
            ("connect", "read", "write", "pool"), STEP_SHARE * self._total_seconds
        )
        return httpcore2.Request(
            "POST",
            httpcore2.URL(
                scheme=target.scheme, host=target.host, port=target.port, target=target.path
            ),
            headers=[
                ("Host", target.host_header),
                ("Content-Length", str(len(body))),
                *headers.items(),
            ],
            content=body,
            extensions={"timeout": timeouts},
        )


async def _end_body(response: httpcore2.Response) -> None:
    """Read the body, so that the connection can be used again; close it if it is long, slow or cut."""
    size = 0
    try:
        with suppress(TimeoutError, *BROKEN):
            async with asyncio.timeout(BODY_SECONDS):
                async for part in response.aiter_stream():
                    size += len(part)
                    if size > MAX_BODY_BYTES:
                        return
    finally:
        await response.aclose()


def _answer(response: httpcore2.Response) -> Answer:
    if len(response.headers) > MAX_HEADERS:
        return Answer(None, NO_HTTP)
    by_name = {name.lower(): value for name, value in response.headers}
    seconds = by_name.get(b"retry-after", b"")  # dates, its other form, are ignored
    return Answer(response.status, None, float(seconds) if seconds.isdigit() else None)


def _why_not_connected(error: httpcore2.NetworkError) -> str:
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
