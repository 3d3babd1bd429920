"""Slow, endless, broken and ambiguous requests over raw sockets, against a real server process.

Tests of the server's patience ask one that has little of it (`impatient`); all others ask one that waits for a minute,
so that a test that a loaded machine holds up is not taken for a slow client.
"""

import contextlib
import json
import socket
import time

import pytest

from tests.e2e.processes import Server, enrolled_client
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair
from tests.support.waiting import PATIENCE_SECONDS, unless_held_up, wait_until

pytestmark = pytest.mark.slow

STALL_SECONDS = 2.0
LONGEST_HOLD_UP_SECONDS = STALL_SECONDS / 8  # of this process, or a test of the server's patience says nothing
MAX_CONNECTIONS = 30


@contextlib.contextmanager
def running_server(folder, stall_seconds):
    server = Server(
        folder,
        "--no-worker",
        TADA_STALL_SECONDS=str(stall_seconds),
        TADA_MAX_CONNECTIONS=str(MAX_CONNECTIONS),
        TADA_MIN_FREE_BYTES="0",
    )
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        yield server
        assert server.process.poll() is None, server.log
        assert "Traceback" not in server.log
    finally:
        server.stop()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with running_server(tmp_path_factory.mktemp("strange"), PATIENCE_SECONDS) as server:
        yield server


@pytest.fixture(scope="module")
def impatient_server(tmp_path_factory):
    with running_server(tmp_path_factory.mktemp("impatient"), STALL_SECONDS) as server:
        yield server


@pytest.fixture(scope="module")
def token(server):
    with enrolled_client(server) as phone:
        return phone.headers["authorization"]


@pytest.fixture(scope="module")
def impatient_token(impatient_server):
    with enrolled_client(impatient_server) as phone:
        return phone.headers["authorization"]


@pytest.fixture
def connect(server):
    with contextlib.ExitStack() as opened:
        yield connector(server, opened)


@pytest.fixture
def connect_impatient(impatient_server):
    with contextlib.ExitStack() as opened:
        yield connector(impatient_server, opened)


def connector(server, opened):
    return lambda: opened.enter_context(socket.create_connection(("127.0.0.1", server.port), PATIENCE_SECONDS))


def read_answer(sock):
    """Status, headers and body of one answer with a Content-Length."""
    head, body = b"", b""
    while not head.endswith(b"\r\n\r\n"):
        byte = sock.recv(1)  # what follows may be the next answer's
        if not byte:
            raise ConnectionError(f"closed after {head!r}")
        head += byte
    first, *lines = head.decode().rstrip().split("\r\n")
    headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    while missing := int(headers.get("content-length", 0)) - len(body):
        body += sock.recv(missing)
    return int(first.split()[1]), headers, body


def refused(sock, status, code):
    """Assert that the answer is this problem document; its headers."""
    got, headers, body = read_answer(sock)
    problem = json.loads(body)
    assert (got, problem["status"], problem["code"]) == (status, status, code), problem
    assert headers["content-type"] == "application/problem+json"
    return headers


def is_closed(sock):
    """True once the server closes the connection, by FIN or by reset; a TimeoutError past our patience."""
    try:
        while sock.recv(65536):
            pass
    except ConnectionResetError:
        pass
    return True


def lives(connect):
    sock = connect()
    sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
    return read_answer(sock)[0] == 200


def upload_head(token, *headers, path="/v1/meals", method="POST"):
    lines = [f"{method} {path} HTTP/1.1", "Host: x", f"Authorization: {token}", *headers, "", ""]
    return "\r\n".join(lines).encode()


def announced_meal(token):
    """The path of a new meal, and the request that announces it."""
    metadata = meal_metadata()
    path = f"/v1/meals/{metadata.pop('id')}"
    body = json.dumps(metadata).encode()
    return path, upload_head(token, f"Content-Length: {len(body)}", path=path, method="PUT") + body


MULTIPART = "Content-Type: multipart/form-data; boundary=b"


def test_body_that_stalls_is_refused_and_one_that_flows_slowly_is_not(connect_impatient, impatient_token):
    def attempt():
        slow, stalled = one_slow_and_one_stalled(connect_impatient, impatient_token)
        assert read_answer(slow)[0] == 202
        refused(stalled, 408, "body_too_slow")

    unless_held_up(attempt, LONGEST_HOLD_UP_SECONDS)


def one_slow_and_one_stalled(connect, token):
    """Two uploads of the same photograph: one comes slowly and wholly, the other stands still."""
    photo = pair()["left"]
    path, announcement = announced_meal(token)
    first = connect()
    first.sendall(announcement)
    assert read_answer(first)[0] == 202
    path = f"{path}/images/left"
    stalled, slow = connect(), connect()
    length = f"Content-Length: {len(photo)}"
    stalled.sendall(upload_head(token, length, "Content-Type: image/jpeg", path=path, method="PUT") + photo[:1000])
    slow.sendall(upload_head(token, length, "Content-Type: image/jpeg", path=path, method="PUT"))
    pieces = 16
    step = len(photo) // pieces + 1
    assert step * STALL_SECONDS / 0.25 > 16 * 1024, "else the photograph is too small for this test"
    for start in range(0, len(photo), step):
        slow.sendall(photo[start : start + step])
        time.sleep(0.25)  # 4 s in all: twice the time that a stall may take
    return slow, stalled


def test_waiting_for_a_change_is_no_stall(connect_impatient, impatient_token):
    path, announcement = announced_meal(impatient_token)
    seconds = STALL_SECONDS + 1

    def attempt():
        sock = connect_impatient()
        sock.sendall(announcement)
        assert read_answer(sock)[0] in (200, 202)
        started = time.monotonic()
        sock.sendall(upload_head(impatient_token, path=f"{path}?wait={seconds}", method="GET"))
        assert read_answer(sock)[0] == 200
        assert time.monotonic() - started >= seconds - 0.5

    unless_held_up(attempt, LONGEST_HOLD_UP_SECONDS)


def test_caller_who_still_sends_reads_the_refusal(connect):
    sock = connect()
    sock.sendall(f"POST /v1/meals HTTP/1.1\r\nHost: x\r\nContent-Length: 500000\r\n{MULTIPART}\r\n\r\n".encode())
    for _ in range(10):  # the first piece after a reset would pass, the second not
        sock.sendall(bytes(50_000))
        time.sleep(0.05)
    refused(sock, 401, "unauthenticated")
    sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
    assert read_answer(sock)[0] == 200


PART_OF_A_PHOTOGRAPH = b'--b\r\nContent-Disposition: form-data; name="left"\r\nContent-Type: image/jpeg\r\n\r\n'
LAST_PART = b'--b\r\nContent-Disposition: form-data; name="metadata"\r\n\r\n{}\r\n--b--\r\n'
ENDLESS = [(PART_OF_A_PHOTOGRAPH, 32, "image_too_large"), (LAST_PART, 70, "too_large")]


@pytest.mark.parametrize(("part", "mebibytes", "code"), ENDLESS, ids=["photograph", "after the last part"])
def test_body_without_an_end_is_refused_at_its_limit(connect, token, part, mebibytes, code):
    sock = connect()
    sock.sendall(upload_head(token, MULTIPART, "Transfer-Encoding: chunked"))
    sock.sendall(b"%x\r\n%s\r\n" % (len(part), part))
    with contextlib.suppress(OSError):
        for _ in range(mebibytes):
            sock.sendall(b"100000\r\n" + bytes(0x100000) + b"\r\n")
    refused(sock, 413, code)


def test_length_past_all_limits_is_refused_before_the_body_has_come(connect, token):
    sock = connect()
    sock.sendall(upload_head(token, MULTIPART, f"Content-Length: {1 << 40}"))
    refused(sock, 413, "too_large")


def test_body_shorter_than_declared_is_given_up_when_the_caller_leaves(connect, token, server):
    sock = connect()
    sock.sendall(upload_head(token, MULTIPART, "Content-Length: 1000") + b"--b\r\n")
    sock.close()
    assert lives(connect)
    staging = server.data_dir / "blobs" / ".incoming"
    wait_until(lambda: not list(staging.glob("*/*")), "what had come to be removed")


def test_caller_who_asks_first_is_told_to_go_on_or_refused_and_then_needs_a_new_connection(connect, token):
    sock = connect()
    sock.sendall(upload_head(token, MULTIPART, "Content-Length: 7", "Expect: 100-continue"))
    assert sock.recv(100).startswith(b"HTTP/1.1 100 ")
    sock.sendall(b"--b--\r\n")
    assert read_answer(sock)[0] == 400
    sock = connect()
    sock.sendall(upload_head("Bearer wrong", MULTIPART, "Content-Length: 1000", "Expect: 100-continue"))
    assert refused(sock, 401, "unauthenticated")["connection"] == "close"
    assert is_closed(sock)


@pytest.mark.parametrize("sent", [b"\x16\x03\x01\x02\r\n\r\n", b"GET / HTTP/1.1\r\nX: " + b"a" * 40_000])
def test_what_is_no_request_is_refused_by_uvicorn_itself(connect, sent):
    sock = connect()
    sock.sendall(sent)
    assert sock.recv(65536).startswith(b"HTTP/1.1 400 ")
    assert is_closed(sock)
    assert lives(connect)


def test_part_with_a_hundred_headers_or_a_long_one_is_refused(connect, token):
    for lines in (b"A: b\r\n" * 100, b"A: " + b"b" * 30_000 + b"\r\n"):
        body = b"--b\r\n" + lines + b"\r\n\r\n--b--\r\n"
        sock = connect()
        sock.sendall(upload_head(token, MULTIPART, f"Content-Length: {len(body)}") + body)
        refused(sock, 400, "malformed_request")


def test_requests_past_the_limit_of_connections_are_refused_and_room_is_made_when_others_leave(connect):
    others = [connect() for _ in range(MAX_CONNECTIONS)]
    wait_until(lambda: not lives(connect), "the connections to be accepted")
    for sock in others:
        sock.close()
    wait_until(lambda: lives(connect), "room for another")
