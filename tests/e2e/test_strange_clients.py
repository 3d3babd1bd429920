"""Slow, endless, broken and ambiguous requests over raw sockets, against a real server process.

Tests of the server's patience ask one that has little of it (`impatient`); all others ask one that waits for a minute,
so that a test that a loaded machine holds up is not taken for a slow client.
"""

import contextlib
import json
import pathlib
import socket
import threading
import time

import pytest

from tests.e2e.processes import Server, enrolled_client
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair
from tests.support.waiting import PATIENCE_SECONDS, unless_held_up, wait_until

pytestmark = pytest.mark.slow

HEADER_SECONDS, STALL_SECONDS = 1.0, 2.0
LONGEST_HOLD_UP_SECONDS = HEADER_SECONDS / 4  # of this process, or a test of the server's patience says nothing
MAX_CONNECTIONS, PER_ADDRESS = 30, 20


@contextlib.contextmanager
def running_server(folder, header_seconds, stall_seconds):
    server = Server(
        folder,
        "--no-worker",
        TADA_HEADER_SECONDS=str(header_seconds),
        TADA_STALL_SECONDS=str(stall_seconds),
        TADA_MAX_CONNECTIONS=str(MAX_CONNECTIONS),
        TADA_MAX_CONNECTIONS_PER_ADDRESS=str(PER_ADDRESS),
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
    with running_server(tmp_path_factory.mktemp("strange"), PATIENCE_SECONDS, PATIENCE_SECONDS) as server:
        yield server


@pytest.fixture(scope="module")
def impatient_server(tmp_path_factory):
    with running_server(tmp_path_factory.mktemp("impatient"), HEADER_SECONDS, STALL_SECONDS) as server:
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
    def connect(source="127.0.0.1", receive_bytes=None):
        sock = opened.enter_context(socket.socket())
        if receive_bytes is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
        sock.settimeout(PATIENCE_SECONDS)
        sock.bind((source, 0))
        sock.connect(("127.0.0.1", server.port))
        return sock

    return connect


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


def test_head_that_comes_byte_by_byte_is_refused_in_time(connect_impatient):
    started = time.monotonic()
    sock = connect_impatient()
    stop = threading.Event()

    def drip():
        for byte in b"GET /healthz HTTP/1.1\r\nHost: x\r\nX-Slow: " + b"a" * 1000:
            if stop.wait(0.1):
                return
            try:
                sock.send(bytes([byte]))
            except OSError:
                return

    dripping = threading.Thread(target=drip)
    dripping.start()
    try:
        headers = refused(sock, 408, "request_timeout")
    finally:
        stop.set()
        dripping.join()
    assert headers["connection"] == "close"
    assert "retry-after" in headers
    assert time.monotonic() - started >= HEADER_SECONDS
    assert is_closed(sock)


def test_connection_that_says_nothing_is_closed_without_a_word(connect_impatient):
    assert connect_impatient().recv(100) == b""


def test_head_of_a_second_request_has_the_same_deadline(connect_impatient):
    def attempt():
        sock = connect_impatient()
        sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
        assert read_answer(sock)[0] == 200
        sock.sendall(b"GET /healthz HT")
        refused(sock, 408, "request_timeout")

    unless_held_up(attempt, LONGEST_HOLD_UP_SECONDS)


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


def test_reader_who_does_not_read_is_cut_off(connect_impatient, impatient_server, impatient_document):
    sock = connect_impatient(receive_bytes=4096)
    answers = 80_000_000 // len(impatient_document)  # 80 MB: more than the system's buffers hold
    sock.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: x\r\n\r\n" * answers)
    received = len(sock.recv(1))  # the server has the connection now: before that `has_closed` would be true
    wait_until(lambda: has_closed(impatient_server, sock), "the server to close the connection")
    try:
        while piece := sock.recv(1 << 20):
            received += len(piece)
    except ConnectionResetError:
        pass
    assert received < answers * len(impatient_document)


@pytest.fixture(scope="module")
def impatient_document(impatient_server):
    """/openapi.json, which is built once and takes seconds; from here on it is at hand."""
    with socket.create_connection(("127.0.0.1", impatient_server.port), timeout=PATIENCE_SECONDS) as sock:
        sock.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: x\r\n\r\n")
        return read_answer(sock)[2]


def has_closed(server, sock):
    """True if no process has the server's end of the connection any more, though the system may still send from it."""
    ends = tuple(f"0100007F:{port:04X}" for port in (server.port, sock.getsockname()[1]))
    rows = [line.split() for line in pathlib.Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return not any((row[1], row[2]) == ends and row[9] != "0" for row in rows)


def test_reader_who_reads_slowly_is_not_cut_off(connect_impatient, impatient_document):
    answers = 20_000_000 // len(impatient_document)  # 20 MB: more than the system's buffers hold
    request = b"GET /openapi.json HTTP/1.1\r\nHost: x\r\n"

    def attempt():
        sock = connect_impatient()
        sock.sendall((request + b"\r\n") * (answers - 1) + request + b"Connection: close\r\n\r\n")
        slowly_until = time.monotonic() + 2 * STALL_SECONDS + 2
        pieces = []
        while piece := sock.recv(20_000 if time.monotonic() < slowly_until else 1 << 20):
            pieces.append(piece)
            if time.monotonic() < slowly_until:
                time.sleep(0.1)
        assert b"".join(pieces).count(b"HTTP/1.1 200") == answers

    unless_held_up(attempt, LONGEST_HOLD_UP_SECONDS)


def test_endless_body_that_nobody_wants_is_cut_after_the_answer(connect):
    sock = connect()
    sock.sendall(
        b"POST /v1/meals HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n" + MULTIPART.encode() + b"\r\n\r\n"
    )
    assert read_answer(sock)[0] == 401
    chunk = b"100000\r\n" + bytes(0x100000) + b"\r\n"
    sent = 0
    try:
        while sent < 1 << 30:
            sock.sendall(chunk)
            sent += 1 << 20
    except (ConnectionResetError, BrokenPipeError):
        pass
    assert sent < 1 << 28


@pytest.mark.parametrize("head", ["HTTP/1.1\r\nConnection: close", "HTTP/1.0"])
def test_caller_of_one_request_who_still_sends_reads_the_refusal(connect, head):
    sock = connect()
    sock.sendall(f"POST /v1/meals {head}\r\nHost: x\r\nContent-Length: 8000000\r\n{MULTIPART}\r\n\r\n".encode())
    for _ in range(10):  # the first piece after a reset would pass, the second not
        sock.sendall(bytes(50_000))
        time.sleep(0.05)
    refused(sock, 401, "unauthenticated")
    assert is_closed(sock)


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


CHUNKED = "Transfer-Encoding: chunked"
WRONG_LENGTHS = [
    (f"Content-Length: {1 << 40}", b"", 413, "too_large"),  # past all limits
    (CHUNKED, b"1\r\na\r\n" * 5000, 400, "malformed_request"),  # chunks of a byte, before they cost much
    (CHUNKED, b"fffffffffffffffffffffff\r\n", 400, "malformed_request"),
]


@pytest.mark.parametrize(("length", "body", "status", "code"), WRONG_LENGTHS, ids=["long", "bytes", "impossible"])
def test_impossible_length_is_refused_before_the_body_has_come(connect, token, length, body, status, code):
    sock = connect()
    sock.sendall(upload_head(token, MULTIPART, length) + body)
    refused(sock, status, code)


def test_body_shorter_than_declared_is_given_up_when_the_caller_leaves(connect, token, server):
    sock = connect()
    sock.sendall(upload_head(token, MULTIPART, "Content-Length: 1000") + b"--b\r\n")
    sock.close()
    assert lives(connect)
    staging = server.data_dir / "blobs" / ".incoming"
    wait_until(lambda: not list(staging.glob("*/*")), "what had come to be removed")


def test_what_follows_the_declared_length_is_the_next_request(connect):
    sock = connect()
    sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\nContent-Length: 2\r\n\r\nabGARBAGE\r\n\r\n")
    assert read_answer(sock)[0] == 200
    refused(sock, 400, "malformed_request")
    assert is_closed(sock)


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


FIRST = b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n"
SECOND = [
    (b"GET /v1/meals/x HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n", 401),
    (b"GET /healthz HTTP/1.1\nHost: x\n\n", 400),
]


@pytest.mark.parametrize(("second", "status"), SECOND)
def test_pipelined_requests_are_answered_in_order_and_read_as_strictly(connect, second, status):
    sock = connect()
    sock.sendall(FIRST + second)
    assert read_answer(sock)[0] == 200
    assert read_answer(sock)[0] == status
    assert is_closed(sock)


GET, POST = b"GET / HTTP/1.1\r\n", b"POST /v1/enrolments HTTP/1.1\r\nHost: x\r\n"
NO_REQUESTS = [
    GET + b"\r\n",
    GET + b"Host: x\r\nHost: y\r\n\r\n",
    GET + b"Host: x\r\nX : y\r\n\r\n",
    GET + b"Host: x\r\nA: b\r\n c: folded\r\n\r\n",
    GET + b"Host: x\r\nA: b\r\n\tc\r\n\r\n",
    GET + b"Host: x\nA: b\r\n\r\n",
    GET + b"Host: x\r\n\n",
    b"GET / HTTP/1.1\nHost: x\n\n",
    b"GET /\xff\xfe HTTP/1.1\r\nHost: x\r\n\r\n",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
    POST + b"Content-Length: 5\r\nContent-Length: 6\r\n\r\nhello",
    POST + b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    POST + b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\nhello",
    POST.replace(b"1.1", b"1.0") + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    POST + b"Transfer-Encoding: gzip, chunked\r\n\r\n0\r\n\r\n",
    POST + b"Content-Length: -1\r\n\r\n",
]
TOO_MUCH = [
    (GET + b"Host: x\r\nX: " + b"a" * 40_000 + b"\r\n\r\n", 431, "headers_too_large"),
    (GET + b"Host: x\r\n" + b"X: a\r\n" * 200 + b"\r\n", 431, "headers_too_large"),
    (b"GET /" + b"a" * 9000 + b" HTTP/1.1\r\nHost: x\r\n\r\n", 414, "target_too_long"),
    (b"GET /v1/foods/%ff%fe HTTP/1.1\r\nHost: x\r\n\r\n", 401, "unauthenticated"),
    (POST + b"Content-Encoding: gzip\r\nContent-Length: 5\r\n\r\nhello", 415, "body_packed"),
]


@pytest.mark.parametrize(
    ("sent", "status", "code"),
    [*((sent, 400, "malformed_request") for sent in NO_REQUESTS), *TOO_MUCH],
    ids=lambda value: value[:60].decode("latin-1") if isinstance(value, bytes) else str(value),
)
def test_request_that_is_none_gets_a_problem_document(connect, sent, status, code):
    sock = connect()
    sock.sendall(sent)
    refused(sock, status, code)
    assert lives(connect)


def test_part_with_a_hundred_headers_or_a_long_one_is_refused(connect, token):
    for lines in (b"A: b\r\n" * 100, b"A: " + b"b" * 30_000 + b"\r\n"):
        body = b"--b\r\n" + lines + b"\r\n\r\n--b--\r\n"
        sock = connect()
        sock.sendall(upload_head(token, MULTIPART, f"Content-Length: {len(body)}") + body)
        refused(sock, 400, "malformed_request")


def test_connections_past_the_limits_are_refused_and_room_is_made_when_others_leave(connect):
    ours = [connect("127.0.0.2") for _ in range(PER_ADDRESS)]
    assert int(refused(connect("127.0.0.2"), 429, "rate_limited")["retry-after"]) > 0
    others = [connect("127.0.0.3") for _ in range(MAX_CONNECTIONS - PER_ADDRESS)]
    assert int(refused(connect("127.0.0.4"), 503, "server_busy")["retry-after"]) > 0
    for sock in [*ours, *others]:
        sock.close()
    wait_until(lambda: lives(connect), "room for another")
