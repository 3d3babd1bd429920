import hashlib
import socket
import time
from itertools import pairwise

import pytest

from tests.support.waiting import PATIENCE_SECONDS
from tests.unit.http.watched_server import port_of, watched_server


async def app(scope, receive, send):
    """Answers with the SHA-256 and the length of the body."""
    digest, length, more = hashlib.sha256(), 0, True
    while more:
        message = await receive()
        if message["type"] != "http.request":
            return
        digest.update(message["body"])
        length += len(message["body"])
        more = message["more_body"]
    body = f"{digest.hexdigest()} {length}".encode()
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(body))]})
    await send({"type": "http.response.body", "body": body})


@pytest.fixture(scope="module")
def port():
    with watched_server(app) as server:
        yield port_of(server)


def head(body, more=b"Connection: close\r\n"):
    return b"PUT / HTTP/1.1\r\nHost: t\r\n%bContent-Length: %d\r\n\r\n" % (more, len(body))


def answers(port, *pieces):
    """Send the pieces each by itself, and that no more comes; what is answered."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_SECONDS) as sock:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for piece in pieces:
            sock.sendall(piece)
            time.sleep(0.005)
        data = b""
        while piece := sock.recv(65536):
            data += piece
    return [part.split(b"HTTP/1.1")[0].decode() for part in data.split(b"\r\n\r\n")[1:]]


def told(body):
    return f"{hashlib.sha256(body).hexdigest()} {len(body)}"


BODY = bytes(range(256)) * 2000


@pytest.mark.parametrize("cuts", [[1, 2, 3, 511_999], list(range(100_000, 512_000, 100_000)), []])
def test_body_in_pieces_arrives_as_it_was_sent(port, cuts):
    pieces = [BODY[start:end] for start, end in pairwise([0, *cuts, len(BODY)])]
    assert answers(port, head(BODY), *pieces) == [told(BODY)]


def test_piece_that_ends_a_body_and_begins_the_next_request_is_divided(port):
    first, second = b"a" * 150_000, b"b" * 150_000
    both = head(first, b"") + first + head(second) + second
    pieces = [both[start:end] for start, end in pairwise([0, 70_000, 140_000, 160_000, len(both)])]
    assert answers(port, *pieces) == [told(first), told(second)]


def test_body_that_ends_too_early_is_not_passed_on_as_whole(port):
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_SECONDS) as sock:
        for piece in (head(BODY), BODY[:50], BODY[50:90_000]):
            sock.sendall(piece)
            time.sleep(0.005)
        sock.shutdown(socket.SHUT_WR)
        assert b" 200 " not in sock.recv(65536)
