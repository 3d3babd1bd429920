"""One HTTP POST to a webhook's receiver: to an address that was checked, within a total time, and no more than a look.

The connection goes to the checked address itself, while `Host`, SNI and the certificate's check go by the name. No
redirect is followed, no proxy of the environment is used, no body is read: the answer is its status line and headers.
"""

import io
import socket
import ssl
import time
from collections.abc import Mapping
from dataclasses import dataclass
from http.client import HTTPException, HTTPResponse

from app.services.safe_address import AddressError, Resolver, Target, parse_target, resolve_safely

TOTAL_SECONDS = 10.0  # connecting, handshake, sending and the answer's head, together
HEAD_BYTES = 32 * 1024  # of the answer; one that has more is none


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of it. status: of the answer; None: there was none, and error says why in a few words of ours."""

    status: int | None
    error: str | None = None
    retry_after_seconds: float | None = None

    @property
    def is_success(self) -> bool:
        """Whether the receiver has taken it."""
        return self.status is not None and 200 <= self.status < 300


class WebhookPost:
    """Sends; one a process, safe to share between threads. resolve, tls: others in tests."""

    def __init__(
        self,
        *,
        allow_loopback: bool,
        total_seconds: float = TOTAL_SECONDS,
        resolve: Resolver | None = None,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self._allow_loopback = allow_loopback
        self._total_seconds = total_seconds
        self._resolve = resolve
        self._tls = tls or ssl.create_default_context()

    def send(self, url: str, headers: Mapping[str, str], body: bytes) -> Answer:
        """POST the body. Never raises for what the receiver or the way to it does."""
        deadline = time.monotonic() + self._total_seconds
        try:
            target = parse_target(url, allow_loopback=self._allow_loopback)
            addresses = resolve_safely(target, allow_loopback=self._allow_loopback, resolve=self._resolve)
            with self._connect(target, addresses, deadline) as connection:
                connection.settimeout(_remaining(deadline))
                connection.sendall(_request(target, headers, body))
                return _read_answer(connection, deadline)
        except AddressError as error:
            return Answer(None, error.message)
        except ssl.SSLCertVerificationError as error:
            return Answer(None, f"The certificate was not accepted: {error.verify_message}."[:200])
        except ssl.SSLError:
            return Answer(None, "TLS could not be established.")
        except TimeoutError:
            return Answer(None, f"No answer within {self._total_seconds:g} seconds.")
        except ConnectionRefusedError:
            return Answer(None, "The connection was refused.")
        except OSError:
            return Answer(None, "The connection failed.")
        except (HTTPException, ValueError):
            return Answer(None, "The answer was not HTTP.")

    def _connect(self, target: Target, addresses: tuple[str, ...], deadline: float) -> socket.socket:
        """A connection to the first address that takes one; TLS is checked against the name."""
        plain: socket.socket | None = None
        for place, address in enumerate(addresses):
            try:
                plain = socket.create_connection((address, target.port), timeout=_remaining(deadline))
                break
            except OSError:
                if place == len(addresses) - 1:
                    raise
        if plain is None:
            raise AddressError("The name in the URL does not resolve.")
        if target.scheme != "https":
            return plain
        try:
            plain.settimeout(_remaining(deadline))
            return self._tls.wrap_socket(plain, server_hostname=target.host)
        except BaseException:
            plain.close()
            raise


class _UntilDeadline(io.RawIOBase):
    """A connection's bytes, as long as the total time lasts: a receiver that drips bytes gains no time by it."""

    def __init__(self, connection: socket.socket, deadline: float) -> None:
        self._connection = connection
        self._deadline = deadline
        self._left = HEAD_BYTES

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]  # the buffer that BufferedReader gives
        self._connection.settimeout(_remaining(self._deadline))
        if not self._left:
            raise HTTPException("the head does not end")
        received = self._connection.recv_into(buffer, min(len(buffer), self._left))
        self._left -= received
        return received


class _Readable:
    """All that HTTPResponse asks of a socket."""

    def __init__(self, connection: socket.socket, deadline: float) -> None:
        self._raw = _UntilDeadline(connection, deadline)

    def makefile(self, _mode: str) -> io.BufferedReader:
        return io.BufferedReader(self._raw, 1024)


def _read_answer(connection: socket.socket, deadline: float) -> Answer:
    response = HTTPResponse(_Readable(connection, deadline), method="POST")  # type: ignore[arg-type]
    try:
        response.begin()
        return Answer(response.status, None, _seconds(response.getheader("Retry-After")))
    finally:
        response.close()


def _request(target: Target, headers: Mapping[str, str], body: bytes) -> bytes:
    """The request as it goes over the wire. Neither the target nor our headers can hold a line's end."""
    lines = [f"POST {target.path} HTTP/1.1", f"Host: {target.host_header}", f"Content-Length: {len(body)}"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    return "\r\n".join([*lines, "Connection: close", "", ""]).encode("ascii") + body


def _seconds(retry_after: str | None) -> float | None:
    """Retry-After in seconds; its other form, a date, is passed over."""
    return float(retry_after) if retry_after is not None and retry_after.isascii() and retry_after.isdigit() else None


def _remaining(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left
