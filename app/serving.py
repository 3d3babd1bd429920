"""`tada serve`: uvicorn with our app and, on the embedded default, a worker process beside it that is kept alive."""

import sys

import structlog
import uvicorn

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
    config = uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=10,
        h11_max_incomplete_event_size=HEADER_BYTES,
    )
    server = _AnnouncingServer(config)
    if embedded_worker is not None:
        embedded_worker.start()
    try:
        server.run()
    finally:
        if embedded_worker is not None:
            embedded_worker.stop()
    return 0 if server.started else 1


class _AnnouncingServer(uvicorn.Server):
    """Says on standard error where it listens, also when the port was chosen by the system."""

    async def startup(self, sockets: list[object] | None = None) -> None:  # type: ignore[override]
        await super().startup(sockets)  # type: ignore[arg-type]
        for server in self.servers:
            for socket in server.sockets:
                host, port = socket.getsockname()[:2]
                print(f"tada-server listens on http://{host}:{port}", file=sys.stderr, flush=True)  # noqa: T201
