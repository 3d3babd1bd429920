"""A real server of an ASGI app behind WatchedProtocol, in a thread."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import uvicorn

from app.http.connection_protocol import ConnectionLimits, ConnectionWatch, WatchedProtocol
from tests.support.waiting import PATIENCE_SECONDS, wait_until


@contextmanager
def watched_server(app: Any, stop_seconds: float = 20.0) -> Iterator[uvicorn.Server]:
    """stop_seconds: what it gives to requests under way when it is told to end."""
    watch = ConnectionWatch(ConnectionLimits(PATIENCE_SECONDS, PATIENCE_SECONDS, 10, 10, stop_seconds=stop_seconds))
    server = uvicorn.Server(
        uvicorn.Config(
            app,
            interface="asgi3",
            port=0,
            http=partial(WatchedProtocol, watch),
            lifespan="off",
            log_level="critical",
            timeout_graceful_shutdown=int(PATIENCE_SECONDS),
        )
    )
    running = threading.Thread(target=server.run)
    running.start()
    try:
        wait_until(lambda: server.started or not running.is_alive(), "the server to start")
        yield server
    finally:
        server.should_exit = True
        running.join()


def port_of(server: uvicorn.Server) -> int:
    return server.servers[0].sockets[0].getsockname()[1]
