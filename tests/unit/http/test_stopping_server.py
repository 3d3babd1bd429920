"""A server that is told to end: an upload under way may come to its end, nothing new begins, the rest is told."""

import json
import socket
import threading
from functools import partial

import pytest
import uvicorn

from app.http.connection_protocol import ConnectionLimits, ConnectionWatch, WatchedProtocol
from tests.support.waiting import PATIENCE_SECONDS, wait_until

HEAD = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 200000\r\n\r\n"
HALF = b"x" * 100_000


async def count_body(scope, receive, send):
    """Answers with the number of bytes that came."""
    count, is_more = 0, True
    while is_more:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        count, is_more = count + len(message["body"]), message.get("more_body", False)
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"6")]})
    await send({"type": "http.response.body", "body": f"{count:06d}".encode()})


class Running:
    """A server in a thread. stop_seconds: what it gives to requests under way."""

    def __init__(self, stop_seconds):
        limits = ConnectionLimits(PATIENCE_SECONDS, PATIENCE_SECONDS, 10, 10, stop_seconds=stop_seconds)
        watch = ConnectionWatch(limits)
        self._begun = threading.Event()
        config = uvicorn.Config(
            self._app,
            interface="asgi3",
            port=0,
            http=partial(WatchedProtocol, watch),
            lifespan="off",
            log_level="critical",
            timeout_graceful_shutdown=int(PATIENCE_SECONDS),
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run)
        self._thread.start()
        wait_until(lambda: self._server.started or not self._thread.is_alive(), "the server to start")
        self.address = self._server.servers[0].sockets[0].getsockname()
        self._connections = []

    def connect(self):
        self._connections.append(socket.create_connection(self.address, timeout=PATIENCE_SECONDS))
        return self._connections[-1]

    async def _app(self, scope, receive, send):
        self._begun.set()
        await count_body(scope, receive, send)

    def stop(self):
        """Told to end while the app has a request; back once nobody listens any more."""
        assert self._begun.wait(PATIENCE_SECONDS)
        self._server.should_exit = True

        def nobody_listens():
            try:
                self.connect().close()
            except ConnectionRefusedError:
                return True

        wait_until(nobody_listens, "the server to listen no more")

    def close(self):
        for connection in self._connections:
            connection.close()
        self._server.should_exit = self._server.force_exit = True
        self._thread.join()

    @property
    def has_ended(self):
        self._thread.join(PATIENCE_SECONDS)
        return not self._thread.is_alive()


@pytest.fixture
def start():
    running = []

    def start(stop_seconds):
        running.append(Running(stop_seconds))
        return running[-1]

    yield start
    for one in running:
        one.close()


def read_all(connection):
    data = b""
    while piece := connection.recv(65536):
        data += piece
    return data


def test_upload_under_way_comes_to_its_end_and_its_connection_too(start):
    server = start(20)
    connection = server.connect()
    connection.sendall(HEAD + HALF)
    server.stop()
    connection.sendall(HALF)
    answer = read_all(connection)
    assert answer.startswith(b"HTTP/1.1 200")
    assert answer.endswith(b"200000")
    assert server.has_ended


def test_upload_that_does_not_end_in_time_is_told_to_come_again(start):
    server = start(1)
    connection = server.connect()
    connection.sendall(HEAD + HALF)
    server.stop()
    head, _, body = read_all(connection).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503")
    assert b"Retry-After: 5" in head or b"retry-after: 5" in head
    told = json.loads(body)
    assert (told["code"], told["retryable"]) == ("server_stops", True)
    assert server.has_ended
