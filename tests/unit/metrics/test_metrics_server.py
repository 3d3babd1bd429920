"""A worker's own port: /metrics for who may read it, /healthz for all."""

import contextlib
import http.client
import socket
import struct
import threading

import pytest
from prometheus_client import CollectorRegistry, Counter
from prometheus_client.parser import text_string_to_metric_families

from app.metrics import server as server_module
from app.metrics.server import MetricsServer, may_read
from tests.support.waiting import PATIENCE_SECONDS, wait_until

TOKEN = "a token for tests of metrics"


@pytest.fixture
def serve():
    """Start a server with this token: get(path, **headers) of it."""
    started = []

    def start(token=None):
        registry = CollectorRegistry()
        Counter("beans", "Counted.", registry=registry).inc(3)
        server = MetricsServer(registry, "127.0.0.1", 0, token)
        server.start()
        started.append(server)

        def get(path, **headers):
            connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE_SECONDS)
            connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
            answer = connection.getresponse()
            body = answer.read().decode()
            connection.close()
            return answer.status, body

        get.port = server.port
        return get

    yield start
    for server in started:
        server.stop()


def test_caller_on_this_machine_reads_without_a_token_and_one_by_a_proxy_or_another_name_finds_nothing(serve):
    get = serve()
    status, text = get("/metrics")
    (family,) = (one for one in text_string_to_metric_families(text) if one.name == "beans")
    assert (status, {sample.name: sample.value for sample in family.samples}["beans_total"]) == (200, 3.0)
    assert get("/metrics", X_Forwarded_For="127.0.0.1")[0] == 404
    assert get("/metrics", Host="worker.example.org")[0] == 404


def test_token_is_asked_for_where_one_is_set_but_for_health(serve):
    get = serve(TOKEN)
    assert get("/metrics")[0] == 401
    assert get("/metrics", Authorization=f"Bearer {TOKEN[:-1]}")[0] == 401
    assert get("/metrics", Authorization=f"Bearer {TOKEN}", Host="worker.example.org")[0] == 200
    assert get("/healthz") == (200, '{"status":"ok"}')
    assert get("/")[0] == get("/metrics/more")[0] == 404


@pytest.mark.parametrize(
    ("address", "host", "word"),
    [("127.0.0.1", host, "may read") for host in ("LOCALHOST:1", "127.0.0.1", "[::1]", "[::1]:9100")]
    + [(address, "localhost:9100", "may read") for address in ("127.0.0.1", "::1", "::ffff:127.0.0.1")]
    + [(address, "localhost:9100", "hidden") for address in ("10.0.0.1", "::ffff:10.0.0.1", "testclient", None)],
)
def test_without_a_token_address_and_name_decide(address, host, word):
    assert may_read(None, address, {"host": host}) == word


def test_proxy_here_that_adds_nothing_is_taken_for_a_caller_from_here():
    """What nginx sends by `proxy_pass http://127.0.0.1:8000` alone; why the doctor asks for a token behind a proxy."""
    assert may_read(None, "127.0.0.1", {"host": "127.0.0.1:8000", "connection": "close"}) == "may read"
    assert may_read(TOKEN, "127.0.0.1", {"host": "127.0.0.1:8000", "connection": "close"}) == "wrong token"
    assert may_read(TOKEN, "127.0.0.1", {"authorization": "Bearer \xe9\xe9"}) == "wrong token"  # not a crash


def test_callers_beyond_the_most_are_turned_away_and_slow_ones_cut_off(serve, monkeypatch):
    """Else whoever reaches the port has the worker start threads without end, and keep them."""
    monkeypatch.setattr(server_module, "MAX_CALLERS", 2)
    monkeypatch.setattr(server_module, "REQUEST_SECONDS", PATIENCE_SECONDS)
    get = serve()
    with contextlib.ExitStack() as stack:
        slow = [stack.enter_context(connection_to(get.port)) for _ in range(2)]
        for caller in slow:
            caller.sendall(b"GET /metrics HTTP/1.0\r\n")
        wait_until(lambda: threads_of_callers() == 2, "two callers")
        turned_away = stack.enter_context(connection_to(get.port))
        assert received(turned_away) == b""
        assert threads_of_callers() == 2
        monkeypatch.setattr(server_module, "REQUEST_SECONDS", 0.2)

        def are_cut_off():
            for caller in slow:  # never silent, never done
                with contextlib.suppress(OSError):
                    caller.sendall(b"x")
            return not threads_of_callers()

        wait_until(are_cut_off, "the slow ones to be cut off", interval_seconds=0.05)
        monkeypatch.setattr(server_module, "REQUEST_SECONDS", 30.0)
        assert get("/metrics")[0] == 200


def connection_to(port):
    return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_SECONDS)


def received(caller):
    """Up to the end; a reset is one too."""
    try:
        return caller.recv(1000)
    except ConnectionResetError:
        return b""


def threads_of_callers():
    return sum("process_request_thread" in thread.name for thread in threading.enumerate())


def test_caller_that_leaves_in_the_middle_is_no_error(serve, capfd):
    get = serve()
    with connection_to(get.port) as caller:
        caller.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # a reset
        caller.sendall(b"GET /met")
    assert get("/metrics")[0] == 200
    assert capfd.readouterr().err == ""
