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
def watched_server(app: Any, **changes: Any) -> Iterator[int]:
    """Yields its port. changes: of uvicorn's configuration."""
    watch = ConnectionWatch(ConnectionLimits(PATIENCE_SECONDS, PATIENCE_SECONDS, 10, 10))
    config = uvicorn.Config(
        app, port=0, http=partial(WatchedProtocol, watch), lifespan="off", log_level="critical", **changes
    )
    server = uvicorn.Server(config)
    running = threading.Thread(target=server.run)
    running.start()
    try:
        wait_until(lambda: server.started or not running.is_alive(), "the server to start")
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        server.should_exit = True
        running.join()
