"""A server that is told to end: an upload under way may come to its end, nothing new begins, the rest is told."""

import json
import socket
import threading
from contextlib import contextmanager

from tests.support.waiting import PATIENCE_SECONDS, wait_until
from tests.unit.http.watched_server import port_of, watched_server

HEAD = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 200000\r\n\r\n"
HALF = b"x" * 100_000


@contextmanager
def half_an_upload(stop_seconds):
    """A connection whose upload is half there, to a server that was told to end and listens no more."""
    begun = threading.Event()

    async def count_body(scope, receive, send):
        begun.set()
        count, is_more = 0, True
        while is_more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            count, is_more = count + len(message["body"]), message.get("more_body", False)
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"6")]})
        await send({"type": "http.response.body", "body": f"{count:06d}".encode()})

    with watched_server(count_body, stop_seconds) as server:
        address = ("127.0.0.1", port_of(server))

        def nobody_listens():
            try:
                socket.create_connection(address, timeout=PATIENCE_SECONDS).close()
            except ConnectionRefusedError:
                return True

        with socket.create_connection(address, timeout=PATIENCE_SECONDS) as connection:
            connection.sendall(HEAD + HALF)
            assert begun.wait(PATIENCE_SECONDS)
            server.should_exit = True
            wait_until(nobody_listens, "the server to listen no more")
            yield connection


def read_all(connection):
    return b"".join(iter(lambda: connection.recv(65536), b""))


def test_upload_under_way_comes_to_its_end_and_its_connection_too():
    with half_an_upload(stop_seconds=20) as connection:
        connection.sendall(HALF)
        answer = read_all(connection)
    assert answer.startswith(b"HTTP/1.1 200")
    assert answer.endswith(b"200000")


def test_upload_that_does_not_end_in_time_is_told_to_come_again():
    with half_an_upload(stop_seconds=1) as connection:
        head, _, body = read_all(connection).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503")
    assert b"retry-after: 5" in head.lower()
    told = json.loads(body)
    assert (told["code"], told["retryable"]) == ("server_stops", True)
