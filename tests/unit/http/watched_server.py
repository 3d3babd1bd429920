"""A real server of an ASGI app behind WatchedProtocol, in a thread."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import uvicorn

from app.http.connection_protocol import ConnectionLimits, ConnectionWatch, WatchedProtocol


@contextmanager
def watched_server(app: Any, **changes: Any) -> Iterator[int]:
    """Yields its port. changes: of uvicorn's configuration."""
    watch = ConnectionWatch(ConnectionLimits(10, 10, 10, 10))
    config = uvicorn.Config(
        app, port=0, http=partial(WatchedProtocol, watch), lifespan="off", log_level="critical", **changes
    )
    server = uvicorn.Server(config)
    running = threading.Thread(target=server.run)
    running.start()
    try:
        while not server.started and running.is_alive():
            time.sleep(0.01)
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        server.should_exit = True
        running.join()
