import socket
import threading
import time
from functools import partial

import pytest
import uvicorn

from app.api.http_protocol import ConnectionLimits, ConnectionWatch, WatchedProtocol


async def app(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"row 1\n", "more_body": True})
    if scope["path"] == "/broken":
        raise RuntimeError("the database went away")
    await send({"type": "http.response.body", "body": b"row 2\n"})


@pytest.fixture(scope="module")
def port():
    watch = ConnectionWatch(ConnectionLimits(10, 10, 10, 10))
    config = uvicorn.Config(app, port=0, http=partial(WatchedProtocol, watch), lifespan="off", log_level="critical")
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


def read_all(port, request):
    with socket.create_connection(("127.0.0.1", port), timeout=10) as sock:
        sock.sendall(request)
        data = b""
        while piece := sock.recv(65536):
            data += piece
    return data


def test_answer_to_http_1_0_that_is_whole_ends_in_order(port):
    assert read_all(port, b"GET /whole HTTP/1.0\r\n\r\n").endswith(b"row 1\nrow 2\n")


def test_answer_to_http_1_0_that_breaks_off_is_no_whole_one(port):
    with pytest.raises(ConnectionResetError):
        read_all(port, b"GET /broken HTTP/1.0\r\n\r\n")
