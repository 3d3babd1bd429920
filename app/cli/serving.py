"""`tada serve`: uvicorn with our app and, with the embedded database, a worker process that is restarted if it ends.

With several processes, they are forked once all that they share is made: the app, the listening sockets, the limits.

Behind a reverse proxy the caller's address is in X-Forwarded-For, which any client can set: it is trusted only from the
proxies in TADA_TRUSTED_PROXIES, by default from none.
"""

import contextlib
import ctypes
import ipaddress
import math
import os
import resource
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterable
from functools import partial
from urllib.parse import urlsplit

import structlog
import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.cli.prefork import WORKER, Prefork
from app.core.errors import InvalidInputError, TadaError, UnavailableError
from app.core.garbage import collect_rarely
from app.core.logs import configure_logging
from app.core.settings import Settings
from app.http.connection_protocol import ConnectionWatch, WatchedProtocol, connection_limits
from app.http.shared_memory import ActiveCounts
from app.http.state import ApiState
from app.jobs.supervisor import WorkerProcess
from app.main import create_app, make_limits
from app.metrics import shared_metrics
from app.operations.check_stores import check_stores
from app.operations.explain_errors import explain_error, explained_errors
from app.people.access.web_origins import origins_of_setting
from app.uploads.waiting import MealWaiter

log = structlog.get_logger()

KEEP_ALIVE_SECONDS = 30
M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8  # malloc.h
FILES_PER_CONNECTION = 4  # its socket, two staged files, one spare
BACKLOG = 2048  # connections that the system keeps until a process takes them: uvicorn's default


def serve(
    settings: Settings, *, with_worker: bool, processes: int = 1, around: Callable[[ASGIApp], ASGIApp] | None = None
) -> int:
    """Serve until SIGTERM or SIGINT, and return the exit status. Raises TadaError if it cannot start.

    With several processes this returns in each of them. around: puts a middleware around the app of a single process.
    """
    configure_logging(settings)
    check_public_url(settings.public_url)
    origins_of_setting(settings.web_origins)
    return_freed_memory()
    raise_open_file_limit(settings.max_connections * FILES_PER_CONNECTION)
    if processes == 1:
        embedded_worker = WorkerProcess(settings) if with_worker and settings.is_embedded else None
        app = create_app(settings)
        outermost: ASGIApp = app if around is None else around(app)
        server = _Server(server_config(settings, ExplainedStartup(outermost)), app, print_addresses)
        return _run(settings, server, embedded_worker=embedded_worker)
    # as many child processes as one server has
    settings = settings.model_copy(update={"api_children": math.ceil(settings.api_children / processes)})
    limits = make_limits(settings, processes)
    of_addresses = ActiveCounts(settings.max_connections, processes)
    app = create_app(settings, limits)
    config = server_config(settings, ExplainedStartup(app), of_addresses)
    sockets = listen(settings.host, settings.port)
    counts = (limits[0].active, of_addresses)

    def on_end(place: int, pid: int) -> None:
        for count in counts if place != WORKER else ():
            count.clear(place)
        shared_metrics.forget_process(pid)

    def on_stop() -> None:
        for listening in sockets:
            listening.close()

    forked = Prefork(
        processes,
        with_worker=with_worker and settings.is_embedded,
        on_ready=lambda: print_addresses(sockets),
        on_end=on_end,
        on_stop=on_stop,
    ).run()
    if isinstance(forked, int):
        return forked
    if forked.place == WORKER:
        on_stop()
        return _keep_worker(settings)
    for count in counts:
        count.become(forked.place)
    return _run(settings, _Server(config, app, lambda _: forked.announce()), sockets=sockets)


def _keep_worker(settings: Settings) -> int:
    """Keep the embedded worker running until SIGTERM."""
    os.environ.pop(shared_metrics.VARIABLE, None)  # it has metrics of its own
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    embedded_worker = WorkerProcess(settings)
    embedded_worker.start()
    stopping.wait()
    embedded_worker.stop()
    return 0


def _run(
    settings: Settings,
    server: "_Server",
    *,
    sockets: list[socket.socket] | None = None,
    embedded_worker: WorkerProcess | None = None,
) -> int:
    with explained_errors():
        check_stores(settings)
    # uvicorn raises the signal again once it has shut down: by default it would end us before our worker is stopped
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    if embedded_worker is not None:
        embedded_worker.start()
    try:
        server.run(sockets)
    except SystemExit:  # uvicorn exits so if the app fails to start
        if server.failure is not None:
            raise server.failure from None
        raise
    finally:
        if embedded_worker is not None:
            embedded_worker.stop()
        signal.signal(signal.SIGTERM, before)
    return 0 if server.started else 1


class ExplainedStartup:
    """The app, with a failure to start kept as a TadaError instead of a traceback in the log."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
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
            else:
                await send(message)

        try:
            await self._app(scope, receive, hold)
        except BaseException as error:
            self.failure = explain_error(error) if failed else None
            for message in failed:
                await send(message if self.failure is None else {"type": message["type"]})
            raise


def listen(host: str, port: int) -> list[socket.socket]:
    """Return listening sockets of all the host's addresses, for several processes. Raises UnavailableError."""
    sockets: list[socket.socket] = []
    try:
        for family, _, _, _, address in socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        ):
            listening = socket.create_server(address, family=family, backlog=BACKLOG)
            sockets.append(_SharedSocket(fileno=listening.detach()))
    except OSError as error:
        for listening in sockets:
            listening.close()
        raise UnavailableError(f"TADA_HOST, TADA_PORT: {host}, port {port}: {error.strerror}.") from None
    return sockets


class _SharedSocket(socket.socket):
    """A listening socket from which each process takes one connection in each turn of its event loop.

    asyncio would take all that wait, so that one process gets the whole of a burst, and keeps it with keep-alive.
    """

    _took_one = False

    def accept(self) -> tuple[socket.socket, object]:
        """Take a connection; after one, say once that none waits."""
        if self._took_one:
            self._took_one = False
            raise BlockingIOError
        accepted = super().accept()
        self._took_one = True
        return accepted


def print_addresses(sockets: Iterable[socket.socket]) -> None:
    """Tell where the server listens, also at a port chosen by the system."""
    for listening in sockets:
        host, port = listening.getsockname()[:2]
        print(f"tada-server listens on http://{host}:{port}", file=sys.stderr, flush=True)


def server_config(settings: Settings, app: ASGIApp, of_addresses: ActiveCounts | None = None) -> uvicorn.Config:
    """Return uvicorn's configuration. of_addresses: connections by address, of several processes.

    Raises InvalidInputError for invalid proxies.
    """
    proxies = trusted_proxies(settings.trusted_proxies)
    watch = ConnectionWatch(connection_limits(settings, proxies), of_addresses)
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        backlog=BACKLOG,
        proxy_headers=bool(proxies),  # uvicorn's default trusts all local callers
        forwarded_allow_ips=proxies,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=settings.stop_seconds,
        loop="asyncio",  # even if others are installed: WatchedProtocol depends on asyncio's
        http=partial(WatchedProtocol, watch),  # type: ignore[arg-type]  # it is only ever called
        ws="none",
    )


def return_freed_memory() -> None:
    """Make glibc return large blocks to the system when they are freed, and use few memory pools.

    By default it keeps the memory of many simultaneous uploads, in a pool per thread, for good.
    """
    with contextlib.suppress(OSError, AttributeError):  # other C libraries have no mallopt and need none
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_ARENA_MAX, 4)
        mallopt(M_MMAP_THRESHOLD, 128 * 1024)  # a fixed value also disables its automatic growth


def raise_open_file_limit(needed: int) -> None:
    """Raise this process's limit of open files to what its connections need, as far as the system allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
    if soft != resource.RLIM_INFINITY and soft < limit:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))


def trusted_proxies(value: str | None) -> list[str]:
    """Return the addresses and networks of TADA_TRUSTED_PROXIES. Raises InvalidInputError, `settings_invalid`.

    Checked here, since uvicorn treats an invalid network as a host name that matches no caller: the proxy would then
    count as the caller of all requests. A network of all addresses is refused: any client could claim any address.
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
    if not is_valid or parts.username or parts.password or parts.query or parts.fragment or url.endswith("/"):
        raise InvalidInputError(
            "TADA_PUBLIC_URL must be like https://tada.example.org: http or https, a host, and no slash at the end.",
            code="settings_invalid",
        )


class _Server(uvicorn.Server):
    """Announces that it listens; on shutdown, ends waiting requests first."""

    def __init__(
        self, config: uvicorn.Config, app: FastAPI, announce: Callable[[Iterable[socket.socket]], None]
    ) -> None:
        super().__init__(config)
        self._app = app
        self._announce = announce

    @property
    def failure(self) -> TadaError | None:
        """Return why the app did not start; None if it did, or for a fault of the program."""
        start = self.config.app
        return start.failure if isinstance(start, ExplainedStartup) else None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        collect_rarely()
        self._announce(listening for server in self.servers for listening in server.sockets)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        state: ApiState | None = getattr(self._app.state, "api", None)
        if state is not None:
            await state.part(MealWaiter).close()
        await super().shutdown(sockets)
