"""Connections that waste the server's time or try to be read in two ways: refused by a problem document, or cut.

uvicorn's protocol over h11 has no deadline for a request's head, none for a slow body or a slow reader, answers what it
cannot parse in plain text, and counts connections only when a request has come. Here every connection is looked at once
a second by one watch a process (`ConnectionWatch`), so a chunk costs no timer.

What the app is doing with a request has no deadline here: `?wait` may take a minute. A proxy in front should let
requests take as long.
"""

import asyncio
import contextlib
import fcntl
import json
import re
import socket
import struct
import termios
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address, ip_network
from typing import Any

import h11
import structlog
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from app.core.errors import (
    HeadersTooLargeError,
    MalformedRequestError,
    RateLimitedError,
    RequestTimeoutError,
    TadaError,
    TargetTooLongError,
    UnavailableError,
)
from app.core.settings import Settings
from app.http.problems import render_problem
from app.http.rate_limit import home_of
from app.http.shared_memory import ActiveCounts

log = structlog.get_logger()

HEADER_BYTES = 32 * 1024  # of a request's head, or of a chunk's and a trailer's
MAX_HEADERS = 100  # a browser behind two proxies sends some thirty
TARGET_BYTES = 8 * 1024  # the longest that RFC 9110, section 4.1, asks servers to take
MIN_PROGRESS_BYTES = 16 * 1024  # in `stall_seconds`: 270 bytes/s by default, less than any network that carries photos
SMALL_CHUNKS, SMALL_CHUNK_BYTES = 2000, 64  # so many chunks that are smaller on average: a bomb, not a photograph
DRAINED_BYTES = 64 * 1024 * 1024  # of a body that is refused before it is read: so that the phone reads the answer
LAST_WORD_SECONDS = 4.0  # before a stopping process is gone: to look, to answer and to linger
LINGER_SECONDS = 2.0  # a refused connection reads on, so that the answer is not lost with a reset
READ_BYTES = 128 * 1024  # of one system call; asyncio takes 256 KiB, which is no faster and counts for each upload
TICK_SECONDS = 1.0
TOLD_SECONDS = 60.0
CONNECTION_RETRY_SECONDS = 5
CONNECTION = "tada.connection"  # ASGI extension: "cut" resets the connection, for a reason that is counted


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """Seconds and counts; trusted proxies speak for many callers and have no limit of their own.

    stop_seconds: what a process that is told to end gives to requests under way.
    """

    header_seconds: float
    stall_seconds: float
    connections: int
    connections_per_address: int
    proxies: Sequence[str] = ()
    stop_seconds: float = 20.0


def connection_limits(settings: Settings, proxies: Sequence[str]) -> ConnectionLimits:
    """The limits that the settings name."""
    return ConnectionLimits(
        settings.header_seconds,
        settings.stall_seconds,
        settings.max_connections,
        settings.max_connections_per_address,
        proxies,
        settings.stop_seconds,
    )


class ConnectionWatch:
    """All connections of one process: counts them, looks at each once a second, tells what was refused in the log.

    of_addresses: the connections of each address, which other processes count too; at least `limits.connections`.
    """

    def __init__(self, limits: ConnectionLimits, of_addresses: ActiveCounts | None = None) -> None:
        self.limits = limits
        self._proxies = [ip_network(proxy) for proxy in limits.proxies]
        self._open: dict[WatchedProtocol, int | None] = {}  # its slot of those counted by address
        self._of_addresses = of_addresses or ActiveCounts(limits.connections)
        self._refused: Counter[str] = Counter()
        self._tick: asyncio.TimerHandle | None = None
        self._told_at = 0.0

    def admit(self, protocol: "WatchedProtocol", address: str) -> TadaError | None:
        """Count a connection that was opened; why it is one too many, or None."""
        self._open[protocol] = None
        if self._tick is None:
            self._tick = protocol.loop.call_later(TICK_SECONDS, self._look, protocol.loop)
        if len(self._open) > 2 * self.limits.connections:  # a flood: not even the refused are answered
            protocol.transport.abort()
        if len(self._open) > self.limits.connections:
            return UnavailableError(
                f"The server has {self.limits.connections} connections, the limit. Try again in a moment.",
                code="server_busy",
                retry_after_seconds=CONNECTION_RETRY_SECONDS,
            )
        at_most = None if self._is_proxy(protocol.client) else self.limits.connections_per_address
        slot = self._open[protocol] = self._of_addresses.add(address, at_most)
        if slot is None:
            return RateLimitedError(
                f"Your address has {self.limits.connections_per_address} connections, the limit.",
                retry_after_seconds=CONNECTION_RETRY_SECONDS,
                limit_at_once=self.limits.connections_per_address,
            )
        return None

    def forget(self, protocol: "WatchedProtocol") -> None:
        """The connection is closed."""
        slot = self._open.pop(protocol, None)
        if slot is not None:
            self._of_addresses.remove(slot)

    def count_refusal(self, code: str) -> None:
        """For the log: a line a minute, not a line a connection, or an attack would fill the disk."""
        self._refused[code] += 1

    def _look(self, loop: asyncio.AbstractEventLoop) -> None:
        now = loop.time()
        for protocol in list(self._open):
            try:
                protocol.look(now)
            except Exception:  # one connection's trouble may not end the watch over all others
                log.exception("connection_watch_failed")
                protocol.transport.abort()
        if self._refused and now - self._told_at >= TOLD_SECONDS:
            log.warning("connections_refused", **self._refused)
            self._refused.clear()
            self._told_at = now
        self._tick = loop.call_later(TICK_SECONDS, self._look, loop) if self._open or self._refused else None

    def _is_proxy(self, client: tuple[str, int] | None) -> bool:
        """By its own address: what is counted of an IPv6 one is its network."""
        try:
            address = ip_address(client[0] if client is not None else "")
        except ValueError:
            return False
        mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
        return any((mapped or address) in network for network in self._proxies)


_HEAD_END = re.compile(rb"\n\r?\n")
_LENIENT = re.compile(rb"(?<!\r)\n|\n[ \t]")  # h11 reads these, a proxy before us may read them otherwise


class WatchedConnection(h11.Connection):
    """h11's parser, stricter: one reading of a body's length only, bounded heads, no bombs of tiny chunks."""

    def __init__(self) -> None:
        super().__init__(h11.SERVER, HEADER_BYTES)
        self.heads = 0
        self.is_reading_body = False
        self.body_bytes = 0
        self.error: TadaError | None = None
        self._chunks = 0

    def next_event(self) -> Any:
        """As h11's. Raises h11.RemoteProtocolError, with `error` set to what the caller is told."""
        if self.their_state is h11.IDLE and _is_lenient(self.trailing_data[0]):
            self.error = MalformedRequestError(
                "The request's head has a line that does not end in CR LF, or a header over two lines (RFC 9112, "
                "sections 2.2 and 5.2)."
            )
            raise h11.RemoteProtocolError(self.error.message)
        try:
            event = super().next_event()
        except h11.RemoteProtocolError as error:
            self.error = _parse_error(error)
            raise
        if isinstance(event, h11.Request):
            self.heads += 1
            self.error = _head_error(event)
            self.is_reading_body, self.body_bytes, self._chunks = self.error is None, 0, 0
        elif isinstance(event, h11.Data):
            self.body_bytes += len(event.data)
            self._chunks += 1
            if self._chunks > SMALL_CHUNKS and self.body_bytes < self._chunks * SMALL_CHUNK_BYTES:
                self.error = MalformedRequestError(
                    f"The body comes in thousands of chunks of less than {SMALL_CHUNK_BYTES} bytes. Send larger ones."
                )
        elif isinstance(event, h11.EndOfMessage):
            self.is_reading_body = False
        if self.error is not None:
            raise h11.RemoteProtocolError(self.error.message, error_status_hint=self.error.status)
        return event


class _Transport:
    """A transport whose `close` the protocol decides on."""

    def __init__(self, plain: asyncio.Transport, close: Callable[[], None]) -> None:
        self._plain = plain
        self.close = close

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plain, name)


class WatchedProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 on one connection, with deadlines."""

    def __init__(
        self,
        watch: ConnectionWatch,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.conn: WatchedConnection = WatchedConnection()
        self._watch = watch
        self._head_since: float | None = None  # a request's head has begun, or the connection has
        self._closes_at: float | None = None  # refused: reads on until then, so that the answer arrives
        self._stops_at: float | None = None  # the process ends: what is still being sent then is refused
        self._progress = (0.0, 0, 0)  # when; how much of a body had come, and of an answer waited, by then

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count it; one too many is answered at once."""
        self._plain = transport
        transport.max_size = READ_BYTES  # type: ignore[attr-defined]  # of asyncio's own transports
        super().connection_made(_Transport(transport, self._close))  # type: ignore[arg-type]  # passes all else on
        now = self.loop.time()
        self._head_since, self._progress = now, (now, 0, 0)
        refusal = self._watch.admit(self, home_of(self.client[0]) if self.client else "unknown")
        if refusal is not None:
            self._refuse(refusal)

    def connection_lost(self, exc: Exception | None) -> None:
        """Count it out."""
        self._watch.forget(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse; what comes after a refusal is dropped."""
        if self._closes_at is not None:
            return
        is_idle = self.cycle is None or self.cycle.response_complete
        if self._head_since is None and is_idle and not self.conn.is_reading_body:
            self._head_since = self.loop.time()
        super().data_received(data)

    def handle_events(self) -> None:
        """As uvicorn's, noting when a head was complete, and how much of a body nobody wanted has come."""
        heads = self.conn.heads
        super().handle_events()
        if self.conn.heads != heads:
            self._head_since = None
            self._progress = (self.loop.time(), 0, 0)
            if self.scope is not None:  # the app sees it: its task has not begun yet
                self.scope["extensions"] = {CONNECTION: {"cut": self._cut}}
        self._look_at_rest_of_body()

    def _look_at_rest_of_body(self) -> None:
        """Of a body that was answered before its end: too much of it is cut off; once it is through, we wait anew."""
        if self.cycle is None or not self.cycle.response_complete or self.transport.is_closing():
            return
        if not self.conn.is_reading_body and self.timeout_keep_alive_task is None:
            self.timeout_keep_alive_task = self.loop.call_later(
                self.timeout_keep_alive, self.timeout_keep_alive_handler
            )
        elif self.conn.is_reading_body and self.conn.body_bytes > DRAINED_BYTES:
            self._cut("body_not_wanted")

    def send_400_response(self, msg: str) -> None:
        """What cannot be parsed: a problem document, then the end of the connection."""
        self._refuse(self.conn.error or MalformedRequestError(msg))

    def eof_received(self) -> None:
        """The caller sends no more: a refused one has read its answer."""
        if self._closes_at is not None:
            self.transport.close()

    def look(self, now: float) -> None:
        """Once a second: whether the caller keeps us waiting for too long."""
        limits = self._watch.limits
        if self._closes_at is not None:
            if now >= self._closes_at:
                self.transport.abort()
        elif self._head_since is not None:
            if now - self._head_since >= limits.header_seconds:
                self._end_slow_head()
        elif self._stops_at is not None and now >= self._stops_at and self.conn.is_reading_body:
            self._refuse(
                UnavailableError(
                    "The server is being stopped before the body has come to its end. Nothing was kept: send it again.",
                    code="server_stops",
                    retry_after_seconds=CONNECTION_RETRY_SECONDS,
                )
            )
        else:
            self._look_at_progress(now, limits.stall_seconds)

    def shutdown(self) -> None:
        """The server goes down: an idle connection ends, a request under way may end, and then its connection does."""
        self._stops_at = self.loop.time() + max(self._watch.limits.stop_seconds - LAST_WORD_SECONDS, 0.0)
        if self._closes_at is not None:
            self.transport.abort()  # refused, it has nothing to finish
        else:
            super().shutdown()

    def _look_at_progress(self, now: float, stall_seconds: float) -> None:
        since, body_bytes, waiting_bytes = self._progress
        waiting = self._waiting_bytes()
        is_sending = self.conn.is_reading_body and not self.flow.read_paused  # else the wait is ours
        is_body_fine = not is_sending or self.conn.body_bytes - body_bytes >= MIN_PROGRESS_BYTES
        was_filled_up = waiting > waiting_bytes  # the app writes on once most is read
        is_reader_fine = not waiting or was_filled_up or waiting_bytes - waiting >= MIN_PROGRESS_BYTES
        if was_filled_up or (is_body_fine and is_reader_fine):
            self._progress = (now, self.conn.body_bytes, waiting)
        elif now - since < stall_seconds:
            return
        elif not is_reader_fine:
            self._cut("reader_too_slow")
        else:
            self._refuse(
                RequestTimeoutError(
                    f"In {stall_seconds:g} s fewer than {MIN_PROGRESS_BYTES} bytes of the body have come. Nothing was "
                    "kept: send it again.",
                    code="body_too_slow",
                )
            )

    def _waiting_bytes(self) -> int:
        """Of an answer: what is not sent yet, and with it what the system has that the caller has not taken.

        The system takes more from us only when a large part of its megabytes is through, a minute's at 10 kB/s: whoever
        looked at our own buffer alone would cut readers who read all the time.
        """
        waiting = self.transport.get_write_buffer_size()
        sock = self.transport.get_extra_info("socket")
        if waiting and sock is not None:
            with contextlib.suppress(OSError):  # a system that does not tell
                waiting += struct.unpack("i", fcntl.ioctl(sock.fileno(), termios.TIOCOUTQ, bytes(4)))[0]
        return waiting

    def _end_slow_head(self) -> None:
        if self.conn.trailing_data[0] or self.conn.heads:
            self._refuse(
                RequestTimeoutError(
                    f"The request's head did not come within {self._watch.limits.header_seconds:g} s. Send it again."
                )
            )
        else:  # nothing has come: a browser opens connections ahead, and wants no answer
            self.transport.close()

    def _refuse(self, error: TadaError) -> None:
        """Answer, if no answer has begun, and end the connection; a request under way hears that its caller is gone."""
        self._watch.count_refusal(error.code)
        is_answered = (
            self.cycle is not None
            and self.cycle.response_started
            and (self.conn.is_reading_body or not self.cycle.response_complete)
        )
        self._end_cycle()
        if is_answered or self.transport.is_closing():
            self._abort()
            return
        response = render_problem(error)
        head = [f"HTTP/1.1 {error.status} {json.loads(bytes(response.body))['title']}", "connection: close"]
        head += [f"{name.decode()}: {value.decode()}" for name, value in response.raw_headers]
        self._closes_at = self.loop.time() + LINGER_SECONDS
        if self.timeout_keep_alive_task is not None:
            self.timeout_keep_alive_task.cancel()
            self.timeout_keep_alive_task = None
        self.flow.resume_reading()
        self.transport.write("\r\n".join([*head, "", ""]).encode() + bytes(response.body))
        self._write_eof()

    def _close(self) -> None:
        """As uvicorn wants it closed, but never so that the caller takes a wrong thing for the answer.

        An answer that breaks off is reset: to HTTP/1.0, which nginx speaks by default, an orderly end says that it is
        whole. Where the caller still sends, the connection reads on for a moment, or the system would reset it.
        """
        is_whole = self.cycle is None or not self.cycle.response_started or self.cycle.response_complete
        if self._closes_at is not None or self._plain.is_closing():
            self._plain.close()
        elif not is_whole:
            self._abort()
        elif self.conn.is_reading_body and not self._plain.get_write_buffer_size():
            self._closes_at = self.loop.time() + LINGER_SECONDS
            self.flow.resume_reading()
            self._write_eof()
        else:
            self._plain.close()

    def _write_eof(self) -> None:
        if self._plain.can_write_eof():
            with contextlib.suppress(OSError):  # the caller has gone
                self._plain.write_eof()

    def _cut(self, code: str) -> None:
        self._watch.count_refusal(code)
        self._end_cycle()
        self._abort()

    def _end_cycle(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
            self.flow.resume_writing()

    def _abort(self) -> None:
        """Now, whatever still waits to be written, in the system's buffers too."""
        sock = self.transport.get_extra_info("socket")
        if sock is not None:
            with contextlib.suppress(OSError):  # the caller was faster
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.transport.abort()


def _is_lenient(received: bytes) -> bool:
    end = _HEAD_END.search(received)
    return _LENIENT.search(received, 0, end.end() if end is not None else len(received)) is not None


def _parse_error(error: h11.RemoteProtocolError) -> TadaError:
    if error.error_status_hint == HeadersTooLargeError.status:
        return _headers_too_large()
    return MalformedRequestError(f"The request is no HTTP/1.1 that can be read: {error}.")


def _headers_too_large() -> HeadersTooLargeError:
    return HeadersTooLargeError(
        f"The request's head is larger than {HEADER_BYTES} bytes, the limit.", limit_bytes=HEADER_BYTES
    )


def _head_error(request: h11.Request) -> TadaError | None:
    if request.http_version not in (b"1.0", b"1.1"):
        return MalformedRequestError("The request is not HTTP/1.1, the only version that is spoken here.")
    if len(request.target) > TARGET_BYTES:
        return TargetTooLongError(
            f"The request's address is longer than {TARGET_BYTES} bytes, the limit.", limit_bytes=TARGET_BYTES
        )
    if sum(len(name) + len(value) for name, value in request.headers) > HEADER_BYTES:  # h11's limit is for parts of one
        return _headers_too_large()
    names = [name for name, _ in request.headers]
    if len(names) > MAX_HEADERS:
        return HeadersTooLargeError(f"The request has more than {MAX_HEADERS} headers, the limit.", limit=MAX_HEADERS)
    if b"content-length" in names and b"transfer-encoding" in names:  # smuggling: a proxy may have read the other one
        return MalformedRequestError("Content-Length and Transfer-Encoding exclude each other (RFC 9112, section 6.3).")
    if b"transfer-encoding" in names and request.http_version == b"1.0":  # which a proxy may pass over: the same
        return MalformedRequestError("HTTP/1.0 has no Transfer-Encoding (RFC 9112, section 6.1).")
    if names.count(b"host") > 1:
        return MalformedRequestError("The request has two Host headers.")
    return None
