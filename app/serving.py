"""`tada serve`: uvicorn with our app and, on the embedded default, a worker process beside it that is kept alive."""

import socket
import sys

import structlog
import uvicorn
from fastapi import FastAPI

from app.api.state import ApiState
from app.jobs.supervisor import WorkerProcess
from app.logs import configure_logging
from app.main import create_app
from app.settings import Settings

log = structlog.get_logger()

KEEP_ALIVE_SECONDS = 30
HEADER_BYTES = 32 * 1024


def serve(settings: Settings, *, with_worker: bool) -> int:
    """Serve until SIGTERM or SIGINT. Returns the exit status."""
    configure_logging(settings)
    embedded_worker = WorkerProcess(settings) if with_worker and settings.is_embedded else None
    app = create_app(settings)
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=10,
        h11_max_incomplete_event_size=HEADER_BYTES,
    )
    server = _Server(config, app)
    if embedded_worker is not None:
        embedded_worker.start()
    try:
        server.run()
    finally:
        if embedded_worker is not None:
            embedded_worker.stop()
    return 0 if server.started else 1


class _Server(uvicorn.Server):
    """Says where it listens, also on a port that the system chose; at its end, wakes who waits for a meal first."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for server in self.servers:
            for listening in server.sockets:
                host, port = listening.getsockname()[:2]
                print(f"tada-server listens on http://{host}:{port}", file=sys.stderr, flush=True)  # noqa: T201

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        state: ApiState | None = getattr(self._app.state, "api", None)
        if state is not None:
            await state.waiter.close()
        await super().shutdown(sockets)
