"""The least that an upload costs: FastAPI and uvicorn take the same request, write its body to a file and sync it.

    python -m benchmarks.bare_endpoint FOLDER

No parsing, no hash, no check, no database. It prints the address that it listens on, as `tada serve` does.
"""

import os
import socket
import sys
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path

import anyio.to_thread
import uvicorn
from fastapi import FastAPI, Request

from app.http.upload import WRITE_BYTES


async def pieces(request: Request) -> AsyncIterator[list[bytes]]:
    """The body in pieces of WRITE_BYTES."""
    pending, size = list[bytes](), 0
    async for chunk in request.stream():
        pending.append(chunk)
        size += len(chunk)
        if size >= WRITE_BYTES:
            yield pending
            pending, size = [], 0
    yield pending


def app_for(folder: Path) -> FastAPI:
    app = FastAPI()

    @app.post("/v1/meals", status_code=202)
    async def post_meal(request: Request) -> dict[str, bool]:
        handle, _ = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb", buffering=0) as file:
            async for some in pieces(request):
                await anyio.to_thread.run_sync(file.writelines, some)
            await anyio.to_thread.run_sync(os.fsync, file.fileno())
        return {"durable": True}

    return app


class Server(uvicorn.Server):
    """Prints its address."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        port = self.servers[0].sockets[0].getsockname()[1]
        print(f"tada-server listens on http://127.0.0.1:{port}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    Server(uvicorn.Config(app_for(Path(sys.argv[1])), port=0, log_level="warning", loop="asyncio")).run()
