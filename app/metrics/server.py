"""A worker's metrics over HTTP, on a separate port, and who may read metrics at all.

/healthz only reports that the process is alive: a worker without its database waits for it, and a
restart would not help. Callers are limited in number and time, so that they cost a worker little.
Metrics name nobody, but numbers of meals and causes of failures are not public: they are for
callers with the token; if none is set, for callers on the same machine that use no proxy.
"""

import contextlib
import ipaddress
import secrets
import socket
import sys
import threading
import time
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Literal, cast

import structlog
from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder

# headers added by proxies: a local caller that sends one forwards another caller's request
FORWARDING_HEADERS = (
    "forwarded",
    "x-forwarded-for",
    "x-forwarded-host",
    "x-forwarded-proto",
    "x-real-ip",
    "via",
)
LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})

Access = Literal["may read", "wrong token", "hidden"]
log = structlog.get_logger()

REQUEST_SECONDS = 10.0  # for a whole request and response; then the connection is closed
MAX_CALLERS = 16  # concurrent, each with a thread; further ones are refused


def may_read(token: str | None, address: str | None, headers: Mapping[str, str]) -> Access:
    """Return a caller's access.

    token: the configured one. address: the caller's. headers: by lower-case name.

    "hidden": no token is set and the caller is remote; it should not learn that metrics exist.
    """
    if token is not None:
        scheme, _, sent_token = headers.get("authorization", "").partition(" ")
        is_right = secrets.compare_digest(sent_token.strip().encode(), token.encode())
        return "may read" if scheme.lower() == "bearer" and is_right else "wrong token"
    return "may read" if _is_local(address) and _is_direct(headers) else "hidden"


def _is_local(address: str | None) -> bool:
    try:
        ip = ipaddress.ip_address((address or "").partition("%")[0])
    except ValueError:
        return False
    mapped = ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None
    return (mapped or ip).is_loopback


def _is_direct(headers: Mapping[str, str]) -> bool:
    """Return whether no proxy is declared and the host name is local: pages in a local browser may use other names."""
    host = headers.get("host", "")
    name = host if host.endswith("]") else host.rpartition(":")[0] or host
    return name.lower() in LOCAL_NAMES and not any(
        header in headers for header in FORWARDING_HEADERS
    )


class MetricsServer:
    """Serves a registry until it is stopped.

    port 0: any free one. token None: only to this machine.
    """

    def __init__(
        self, registry: CollectorRegistry, host: str, port: int, token: str | None
    ) -> None:
        self._server = _Server((host, port), _Handler)
        self._server.registry = registry
        self._server.token = token
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="metrics", daemon=True
        )

    @property
    def port(self) -> int:
        """Return the port that it listens on."""
        return self._server.server_port

    def start(self) -> None:
        """Start serving in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    """One thread per caller, limited in number and time.

    One thread accepts and closes connections.
    """

    daemon_threads = True
    registry: CollectorRegistry
    token: str | None

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._lock = threading.Lock()
        self._since: dict[socket.socket, float] = {}  # start of each caller; seconds, monotonic
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: object) -> None:
        """Handle a request in a separate thread; refuse it if there are too many."""
        with self._lock:
            if len(self._since) >= MAX_CALLERS:
                self.shutdown_request(request)
                return
            self._since[request] = time.monotonic()
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread could be started
            self._forget(request)
            raise

    def process_request_thread(self, request: Any, client_address: object) -> None:
        """Handle the request, then forget its caller."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._forget(request)

    def service_actions(self) -> None:
        """Close connections that have taken too long; called twice a second.

        Their threads then fail and end.
        """
        with self._lock:
            for request, since in self._since.items():
                if time.monotonic() - since > REQUEST_SECONDS:
                    with contextlib.suppress(OSError):
                        request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: object) -> None:  # noqa: ARG002  # socketserver's own
        """Log errors, except those of callers that disconnect or are disconnected."""
        error = sys.exception()
        if not isinstance(error, OSError):
            log.error("metrics_not_told", exc_info=error)

    def _forget(self, request: socket.socket) -> None:
        with self._lock:
            self._since.pop(request, None)


class _Handler(BaseHTTPRequestHandler):
    timeout = REQUEST_SECONDS
    server_version = "tada"
    sys_version = ""

    def do_GET(self) -> None:  # http.server's name
        path = self.path.partition("?")[0]
        if path == "/healthz":
            self._answer(HTTPStatus.OK, "application/json", b'{"status":"ok"}')
        elif path != "/metrics":
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"There is /metrics and /healthz.\n")
        else:
            self._answer_metrics()

    def _answer_metrics(self) -> None:
        server = cast("_Server", self.server)
        headers: Mapping[str, str] = {name.lower(): value for name, value in self.headers.items()}
        match may_read(server.token, str(self.client_address[0]), headers):
            case "may read":
                encode, content_type = choose_encoder(headers.get("accept", ""))
                self._answer(HTTPStatus.OK, content_type, encode(server.registry))
            case "wrong token":
                self._answer(HTTPStatus.UNAUTHORIZED, "text/plain", b"Send the bearer token.\n")
            case "hidden":
                self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"Nothing here.\n")

    def _answer(self, status: HTTPStatus, content_type: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(body)))
        if status is HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", "Bearer")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # http.server's own name
        """Log nothing: a line per scrape is useless."""
