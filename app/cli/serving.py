"""`tada serve`: uvicorn with our app and, with the embedded database, a worker process that is restarted if it ends.

Several processes are uvicorn's own workers, each with an app of its own; they share the listening
sockets.

Behind a reverse proxy the caller's address is in X-Forwarded-For, which any client can set: it is
trusted only from the proxies in TADA_TRUSTED_PROXIES, by default from none. Slow heads are the
proxy's to end (docs/decisions/0060).
"""

import asyncio
import contextlib
import ctypes
import ipaddress
import math
import multiprocessing
import os
import resource
import signal
import socket
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.config import STARTUP_FAILURE
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState
from uvicorn.supervisors import Multiprocess

from app.core.errors import InvalidInputError, TadaError, UnavailableError
from app.core.logs import configure_logging
from app.core.process_life import collect_rarely, die_with_parent
from app.core.settings import Settings
from app.db.session import open_database
from app.http.state import CUT
from app.jobs.supervisor import WorkerProcess, settings_environment
from app.main import create_app
from app.operations.explain_errors import check_stores, explain_error, explained_errors
from app.operations.prepare import prepare_patiently
from app.operations.prepare_apart import prepare_apart
from app.people.access.web_origins import origins_of_setting

KEEP_ALIVE_SECONDS = 30
HEAD_BYTES = 32 * 1024  # of a request's head, as far as it has come
HEALTH_SECONDS = 60  # a process that does not answer its supervisor for so long is replaced
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # malloc.h
FILES_PER_CONNECTION = 4  # its socket, two staged files, one spare
BACKLOG = 2048  # connections that the system keeps until a process takes them: uvicorn's default


def serve(
    settings: Settings,
    *,
    with_worker: bool,
    processes: int = 1,
    around: Callable[[ASGIApp], ASGIApp] | None = None,
) -> int:
    """Serve until SIGTERM or SIGINT, and return the exit status.

    Raises TadaError if it cannot start.

    around: puts a middleware around the app of a single process.
    """
    configure_logging(settings)
    check_public_url(settings.public_url)
    origins_of_setting(settings.web_origins)
    raise_open_file_limit(settings.max_connections * FILES_PER_CONNECTION)
    with explained_errors():
        check_stores(settings)
    embedded_worker = WorkerProcess(settings) if with_worker and settings.is_embedded else None
    if processes > 1:
        return _serve_in_several(settings, processes, embedded_worker)
    return_freed_memory()
    app: ASGIApp = create_app(settings)
    with _listening(settings) as sockets, _beside(embedded_worker):
        startup = ExplainedStartup(app if around is None else around(app), sockets)
        try:
            uvicorn.Server(server_config(settings, startup)).run(sockets)
        except SystemExit:  # uvicorn exits so if the app fails to start
            if startup.failure is not None:
                raise startup.failure from None
            raise
    return 0


def _serve_in_several(
    settings: Settings, processes: int, embedded_worker: WorkerProcess | None
) -> int:
    """Prepare, so that what prevents a start is told once, then let uvicorn's workers serve."""
    with explained_errors():
        database = open_database(settings)
        prepare_patiently(database, settings, first=prepare_apart)
        database.dispose()
    # as many child processes as one server has
    api_children = math.ceil(settings.api_children / processes)
    os.environ |= settings_environment(settings.model_copy(update={"api_children": api_children}))
    config = server_config(settings, "app.cli.serving:app_of_worker", processes)
    with _listening(settings) as sockets, _beside(embedded_worker):
        print_addresses(sockets)
        supervisor = _Supervisor(config, sockets)
        supervisor.run()
    has_failed = any(process.exitcode == STARTUP_FAILURE for process in supervisor.processes)
    return 1 if has_failed else 0


def app_of_worker() -> ASGIApp:
    """Return the app of one of several processes, which reads its settings from the environment."""
    parent = multiprocessing.parent_process()
    if parent is not None and parent.pid is not None:
        die_with_parent(parent.pid)
    settings = Settings()
    configure_logging(settings)
    return_freed_memory()
    return ExplainedStartup(create_app(settings))


class _Supervisor(Multiprocess):
    """Uvicorn's, which stops listening itself as soon as it ends its workers: else callers would wait in vain."""

    def terminate_all(self) -> None:
        for listening in self.sockets:
            listening.close()
        super().terminate_all()


class CuttableProtocol(H11Protocol):
    """uvicorn's HTTP/1.1, whose connection the app can reset: sandboxes lose requests and answers."""

    def __init__(
        self,
        config: uvicorn.Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, {**app_state, CUT: self.cut}, _loop)

    def cut(self) -> None:
        """Reset the connection, whatever still waits to be written."""
        sock = self.transport.get_extra_info("socket")
        with contextlib.suppress(OSError):  # the caller was faster
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.transport.abort()


@contextlib.contextmanager
def _listening(settings: Settings) -> Iterator[list[socket.socket]]:
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(listening) for listening in listen(settings.host, settings.port)]


@contextlib.contextmanager
def _beside(embedded_worker: WorkerProcess | None) -> Iterator[None]:
    """Keep the worker until the server has ended, as requests may wait for it."""
    # uvicorn raises the signal again once it has shut down: by default it would end us before our
    # worker is stopped
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    if embedded_worker is not None:
        embedded_worker.start()
    try:
        yield
    finally:
        if embedded_worker is not None:
            embedded_worker.stop()
        signal.signal(signal.SIGTERM, before)


class ExplainedStartup:
    """The app, with a failure to start kept as a TadaError instead of a traceback in the log.

    sockets: whose addresses are printed once it has started.
    """

    def __init__(self, app: ASGIApp, sockets: Iterable[socket.socket] = ()) -> None:
        self._app = app
        self._sockets = sockets
        self.failure: TadaError | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI call."""
        if scope["type"] != "lifespan":
            await self._app(scope, receive, send)
            return
        failed: list[Message] = []

        async def hold(message: Message) -> None:
            """Hold back the failure message, which contains the traceback and precedes the exception."""
            if message["type"] == "lifespan.startup.failed":
                failed.append(message)
                return
            if message["type"] == "lifespan.startup.complete":
                collect_rarely()
                print_addresses(self._sockets)
            await send(message)

        try:
            await self._app(scope, receive, hold)
        except BaseException as error:
            self.failure = explain_error(error) if failed else None
            for message in failed:
                await send(message if self.failure is None else {"type": message["type"]})
            raise


def listen(host: str, port: int) -> list[socket.socket]:
    """Return listening sockets of all the host's addresses. Raises UnavailableError."""
    sockets: list[socket.socket] = []
    try:
        for family, _, _, _, address in socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        ):
            sockets.append(socket.create_server(address, family=family, backlog=BACKLOG))
    except OSError as error:
        for listening in sockets:
            listening.close()
        raise UnavailableError(
            f"TADA_HOST, TADA_PORT: {host}, port {port}: {error.strerror}."
        ) from None
    return sockets


def print_addresses(sockets: Iterable[socket.socket]) -> None:
    """Tell where the server listens, also at a port chosen by the system."""
    for listening in sockets:
        host, port = listening.getsockname()[:2]
        print(f"tada-server listens on http://{host}:{port}", file=sys.stderr, flush=True)


def server_config(settings: Settings, app: ASGIApp | str, processes: int = 1) -> uvicorn.Config:
    """Return uvicorn's configuration.

    app: of several processes the function that makes it, by its name.

    Raises InvalidInputError for invalid proxies.
    """
    proxies = trusted_proxies(settings.trusted_proxies)
    return uvicorn.Config(
        app,
        factory=isinstance(app, str),
        workers=processes,
        log_config=None,
        access_log=False,
        server_header=False,
        backlog=BACKLOG,
        proxy_headers=bool(proxies),  # uvicorn's default trusts all local callers
        forwarded_allow_ips=proxies,
        limit_concurrency=settings.max_connections,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=settings.stop_seconds,
        timeout_worker_healthcheck=HEALTH_SECONDS,
        http=CuttableProtocol,
        h11_max_incomplete_event_size=HEAD_BYTES,
        ws="none",
    )


def return_freed_memory() -> None:
    """Make glibc return large blocks to the system when they are freed, and use few memory pools.

    By default it keeps the memory of many simultaneous uploads, in a pool per thread, for good.
    asyncio's buffers of 256 KiB are reused: returning each of them cost an upload a quarter of its
    time in this process.
    """
    # other C libraries have no mallopt and need none
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_ARENA_MAX, 4)
        mallopt(M_MMAP_THRESHOLD, 512 * 1024)  # a fixed value also disables its automatic growth
        mallopt(M_TRIM_THRESHOLD, 8 * 1024 * 1024)


def raise_open_file_limit(needed: int) -> None:
    """Raise this process's limit of open files to what its connections need, as far as the system allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
    if soft != resource.RLIM_INFINITY and soft < limit:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))


def trusted_proxies(value: str | None) -> list[str]:
    """Return the addresses and networks of TADA_TRUSTED_PROXIES.

    Raises InvalidInputError, `settings_invalid`.

    Checked here, since uvicorn treats an invalid network as a host name that matches no caller: the
    proxy would then count as the caller of all requests. A network of all addresses is refused: any
    client could claim any address.
    """
    proxies = []
    for part in (value or "").split(","):
        if not part.strip():
            continue
        try:
            network = ipaddress.ip_network(part.strip())
        except ValueError as error:
            raise InvalidInputError(
                f"TADA_TRUSTED_PROXIES: {part.strip()!r} is neither an address nor a network ({error}). Write it like "
                "10.0.0.5 or 10.0.0.0/24, separated by commas.",
                code="settings_invalid",
            ) from None
        if network.prefixlen == 0:
            raise InvalidInputError(
                f"TADA_TRUSTED_PROXIES: {part.strip()} covers all addresses: any client could claim any address. "
                "Give the proxies' own addresses.",
                code="settings_invalid",
            )
        proxies.append(str(network.network_address) if network.num_addresses == 1 else str(network))
    return proxies


def check_public_url(url: str | None) -> None:
    """Raise InvalidInputError, `settings_invalid`, for a URL by which phones could not reach the server."""
    if url is None:
        return
    try:
        parts = urlsplit(url)
        is_valid = parts.scheme in ("https", "http") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_valid = False
    if (
        not is_valid
        or parts.username
        or parts.password
        or parts.query
        or parts.fragment
        or url.endswith("/")
    ):
        raise InvalidInputError(
            "TADA_PUBLIC_URL must be like https://tada.example.org: http or https, a host, and no slash at the end.",
            code="settings_invalid",
        )
