"""`tada serve`: uvicorn with our app and, on the embedded default, a worker process beside it that is kept alive.

Behind a reverse proxy the caller's address stands in X-Forwarded-For, which anybody can write: it counts only from the
proxies that TADA_TRUSTED_PROXIES names, and from nobody by default.
"""

import contextlib
import ctypes
import gc
import ipaddress
import resource
import socket
import sys
from functools import partial
from urllib.parse import urlsplit

import structlog
import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import InvalidInputError, TadaError
from app.core.logs import configure_logging
from app.core.settings import Settings
from app.http.connection_protocol import ConnectionWatch, WatchedProtocol, connection_limits
from app.http.state import ApiState
from app.jobs.supervisor import WorkerProcess
from app.main import create_app
from app.operations.check_stores import check_stores
from app.operations.in_words import in_words, told_in_words
from app.uploads.waiting import MealWaiter

log = structlog.get_logger()

KEEP_ALIVE_SECONDS = 30
M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8  # malloc.h
FILES_A_CONNECTION = 4  # its socket, two files in the making, one to spare


def serve(settings: Settings, *, with_worker: bool) -> int:
    """Serve until SIGTERM or SIGINT. Returns the exit status. Raises TadaError, in words, where it cannot begin."""
    configure_logging(settings)
    check_public_url(settings.public_url)
    with told_in_words():
        check_stores(settings)
    give_memory_back()
    embedded_worker = WorkerProcess(settings) if with_worker and settings.is_embedded else None
    app = create_app(settings)
    start = ToldStart(app)
    server = _Server(server_config(settings, start), app)
    allow_files(settings.max_connections * FILES_A_CONNECTION)
    if embedded_worker is not None:
        embedded_worker.start()
    try:
        server.run()
    except SystemExit:  # uvicorn's own end of what did not begin
        if start.failure is not None:
            raise start.failure from None
        raise
    finally:
        if embedded_worker is not None:
            embedded_worker.stop()
    return 0 if server.started else 1


class ToldStart:
    """The app; what keeps it from beginning is kept in words, and no traceback of it goes to the log."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self.failure: TadaError | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """A call of ASGI."""
        if scope["type"] != "lifespan":
            await self._app(scope, receive, send)
            return
        failed: list[Message] = []

        async def hold(message: Message) -> None:
            """What tells that it failed has the traceback with it, and comes before the error itself."""
            if message["type"] == "lifespan.startup.failed":
                failed.append(message)
            else:
                await send(message)

        try:
            await self._app(scope, receive, hold)
        except BaseException as error:
            self.failure = in_words(error) if failed else None
            for message in failed:
                await send(message if self.failure is None else {"type": message["type"]})
            raise


def server_config(settings: Settings, app: ASGIApp) -> uvicorn.Config:
    """How uvicorn runs the app. Raises InvalidInputError for proxies that are none."""
    proxies = trusted_proxies(settings.trusted_proxies)
    watch = ConnectionWatch(connection_limits(settings, proxies))
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=bool(proxies),  # uvicorn's own default trusts whoever is on this machine
        forwarded_allow_ips=proxies,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=settings.stop_seconds,
        loop="asyncio",  # whatever else is installed: WatchedProtocol sets what is asyncio's own
        http=partial(WatchedProtocol, watch),  # type: ignore[arg-type]  # it is only ever called
        ws="none",
    )


def give_memory_back() -> None:
    """Have glibc give large blocks back when they are freed, and keep few pools for its threads.

    By default it keeps what many uploads at once needed, in a pool a thread, for good.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library has neither the call nor the habit
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_ARENA_MAX, 4)
        mallopt(M_MMAP_THRESHOLD, 128 * 1024)  # which also ends its growing by itself


def allow_files(wanted: int) -> None:
    """Raise this process's limit of open files to what its connections need, as far as the system lets it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def trusted_proxies(value: str | None) -> list[str]:
    """Addresses and networks of TADA_TRUSTED_PROXIES. Raises InvalidInputError, `settings_invalid`.

    Checked here, since uvicorn takes what is no network for a name that nobody has: the proxy would count as the caller
    of all requests. Everybody is no proxy: then anybody could write any address.
    """
    proxies = []
    for word in (value or "").split(","):
        if not word.strip():
            continue
        try:
            network = ipaddress.ip_network(word.strip())
        except ValueError as error:
            raise InvalidInputError(
                f"TADA_TRUSTED_PROXIES: {word.strip()!r} is neither an address nor a network ({error}). Write it like "
                "10.0.0.5 or 10.0.0.0/24, comma between.",
                code="settings_invalid",
            ) from None
        if network.prefixlen == 0:
            raise InvalidInputError(
                f"TADA_TRUSTED_PROXIES: {word.strip()} is everybody: anybody could claim any address. Name the "
                "proxies' own addresses.",
                code="settings_invalid",
            )
        proxies.append(str(network.network_address) if network.num_addresses == 1 else str(network))
    return proxies


def check_public_url(url: str | None) -> None:
    """Raises InvalidInputError, `settings_invalid`, for what phones could not reach the server by."""
    if url is None:
        return
    try:
        parts = urlsplit(url)
        is_fine = parts.scheme in ("https", "http") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_fine = False
    if not is_fine or parts.username or parts.password or parts.query or parts.fragment or url.endswith("/"):
        raise InvalidInputError(
            "TADA_PUBLIC_URL must be like https://tada.example.org: http or https, a host, and no slash at its end.",
            code="settings_invalid",
        )


class _Server(uvicorn.Server):
    """Says where it listens, also on a port that the system chose; at its end, wakes who waits for a meal first."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        gc.collect()
        gc.freeze()  # what is there now stays: collecting it again and again would hold up requests by 0.1 s
        for server in self.servers:
            for listening in server.sockets:
                host, port = listening.getsockname()[:2]
                print(f"tada-server listens on http://{host}:{port}", file=sys.stderr, flush=True)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        state: ApiState | None = getattr(self._app.state, "api", None)
        if state is not None:
            await state.part(MealWaiter).close()
        await super().shutdown(sockets)
