"""The least that an upload costs: FastAPI and uvicorn take the same request, write its body to a file and sync it.

    python -m benchmarks.bare_endpoint FOLDER [CHILDREN]

With CHILDREN, as many processes also decode each photograph once, by the server's own decoder. No multipart parser,
no hash, no check, no database. It prints the address that it listens on, as `tada serve` does.
"""

import asyncio
import multiprocessing
import os
import socket
import sys
import tempfile
from collections.abc import AsyncIterator
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path

import anyio.to_thread
import uvicorn
from fastapi import FastAPI, Request

from app.core.errors import Failure
from app.core.process_life import die_with_parent
from app.http.upload import WRITE_BYTES
from app.vision.photograph.photo import read_reduced_photo

MAX_PIXELS = 60_000_000
JPEG_START = b"\r\n\r\n\xff\xd8"


def decode_photographs(path: str) -> None:
    """Decode each JPEG of a multipart body, as app/meals/estimate/receive_task.py does."""
    for part in Path(path).read_bytes().split(JPEG_START)[1:]:
        photo = b"\xff\xd8" + part[: part.rindex(b"\r\n--")]
        read = read_reduced_photo(photo, max_pixels=MAX_PIXELS, least_long_side_px=1)
        if isinstance(read, Failure):
            raise SystemExit(read.message)


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


def app_for(folder: Path, children: Executor | None) -> FastAPI:
    app = FastAPI()

    @app.post("/v1/meals", status_code=202)
    async def post_meal(request: Request) -> dict[str, bool]:
        handle, path = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb", buffering=0) as file:
            async for some in pieces(request):
                await anyio.to_thread.run_sync(file.writelines, some)
            await anyio.to_thread.run_sync(os.fsync, file.fileno())
        if children is not None:
            await asyncio.get_running_loop().run_in_executor(children, decode_photographs, path)
        return {"durable": True}

    return app


class Server(uvicorn.Server):
    """Prints its address."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        port = self.servers[0].sockets[0].getsockname()[1]
        print(f"tada-server listens on http://127.0.0.1:{port}", file=sys.stderr, flush=True)


def main() -> None:
    folder, *count = sys.argv[1:]
    spawning = multiprocessing.get_context("spawn")
    children = (
        ProcessPoolExecutor(int(count[0]), spawning, die_with_parent, (os.getpid(),))
        if count
        else None
    )
    app = app_for(Path(folder), children)
    Server(uvicorn.Config(app, port=0, log_level="warning", loop="asyncio")).run()


if __name__ == "__main__":
    main()
