import socket

import pytest

from tests.support.waiting import PATIENCE_SECONDS
from tests.unit.http.watched_server import watched_server


async def app(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"row 1\n", "more_body": True})
    if scope["path"] == "/broken":
        raise RuntimeError("the database went away")
    await send({"type": "http.response.body", "body": b"row 2\n"})


def read_all(port, request):
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_SECONDS) as sock:
        sock.sendall(request)
        return b"".join(iter(lambda: sock.recv(65536), b""))


def test_answer_to_http_1_0_that_breaks_off_is_no_whole_one():
    with watched_server(app) as port:
        assert read_all(port, b"GET /whole HTTP/1.0\r\n\r\n").endswith(b"row 1\nrow 2\n")
        with pytest.raises(ConnectionResetError):
            read_all(port, b"GET /broken HTTP/1.0\r\n\r\n")
