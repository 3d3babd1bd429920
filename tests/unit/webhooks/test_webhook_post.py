"""One POST, over real sockets: pinned to the checked address, within its time, and deaf to what receivers try."""

import itertools
import socket
import threading

import httpx2
import pytest

from app.webhooks.safe_address import parse_target
from app.webhooks.webhook_post import WebhookPost
from tests.receivers import certificates, raw_receiver, read_request, receiver

BODY = b'{"a":1}'
OK = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n"


def post(url, *, seconds=10.0, **options):
    return WebhookPost(allow_loopback=True, total_seconds=seconds, **options).send(url, {"X-Test": "1"}, BODY)


def posted_to(talk, seconds=10.0):
    with raw_receiver(talk) as port:
        return post(f"http://127.0.0.1:{port}/", seconds=seconds)


def answering(*chunks):
    def talk(connection):
        read_request(connection)
        for chunk in chunks:
            connection.sendall(chunk)

    return talk


@pytest.mark.parametrize(("status", "is_success"), [(200, True), (204, True), (299, True), (300, False), (500, False)])
def test_success_is_2xx_and_nothing_else(status, is_success):
    with receiver(answer=status) as hook:
        answer = post(hook.url)
    assert (answer.status, answer.error, answer.is_success) == (status, None, is_success)
    (got,) = hook.received
    assert (got.path, got.body, got.headers["X-Test"]) == ("/hook?a=b", BODY, "1")
    assert got.headers["Host"] == f"127.0.0.1:{hook.port}"


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_redirect_is_a_failure_and_is_not_followed(status):
    with receiver() as inner, receiver(answer=status, headers={"Location": inner.url}) as outer:
        assert not post(outer.url).is_success
        assert len(outer.received) == 1
    assert inner.received == []


def test_proxies_of_the_environment_are_not_used(monkeypatch):
    with receiver() as proxy, receiver() as hook:
        for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
            monkeypatch.setenv(name, f"http://127.0.0.1:{proxy.port}")
        monkeypatch.delenv("no_proxy", raising=False)
        assert post(hook.url).is_success
    assert (len(hook.received), proxy.received) == (1, [])


def test_connection_goes_to_the_checked_address_while_name_and_certificate_are_the_urls(tmp_path):
    server, client = certificates(tmp_path, "hooks.example.org")
    seen = []
    server.sni_callback = lambda _, name, __: seen.append(name)
    asked = []

    def resolve(host, port):
        asked.append((host, port))
        return ["127.0.0.1"]

    with receiver(tls=server) as hook:
        answer = post(f"https://hooks.example.org:{hook.port}/a", resolve=resolve, tls=client)
    assert answer.is_success, answer
    assert seen == ["hooks.example.org"]
    assert asked == [("hooks.example.org", hook.port)]  # once
    assert hook.received[0].headers["Host"] == f"hooks.example.org:{hook.port}"


@pytest.mark.parametrize("name", ["other.example.org", "127.0.0.1"])
def test_certificate_of_another_name_is_refused(tmp_path, name):
    """Also one for the address that is connected to: the URL's name counts."""
    server, client = certificates(tmp_path, name)
    with receiver(tls=server) as hook:
        url = f"https://hooks.example.org:{hook.port}/"
        answer = post(url, resolve=lambda *_: ["127.0.0.1"], tls=client)
    assert answer.status is None
    assert answer.error.startswith("The certificate was not accepted")
    assert hook.received == []


def test_untrusted_certificate_is_refused(tmp_path):
    server, _ = certificates(tmp_path, "127.0.0.1")
    with receiver(tls=server) as hook:
        answer = post(f"https://127.0.0.1:{hook.port}/")
    assert answer.error.startswith("The certificate was not accepted")
    assert hook.received == []


def test_name_that_resolves_to_a_private_address_later_is_not_called():
    """DNS rebinding: a public answer when the webhook was made, the loopback at its delivery."""
    answers = itertools.chain([["8.8.8.8"]], itertools.repeat(["127.0.0.1"]))
    with receiver() as inner:
        sender = WebhookPost(allow_loopback=False, resolve=lambda *_: next(answers))
        url = f"https://hooks.example.org:{inner.port}/"
        assert sender._resolve("hooks.example.org", inner.port) == ["8.8.8.8"]
        answer = sender.send(url, {}, BODY)
    assert (answer.status, answer.error) == (None, "The URL leads to an address that is not public.")
    assert inner.received == []


def test_only_the_checked_addresses_are_connected_to():
    called = []

    def refuse(request):
        called.append((request.url.host, request.url.port or 443, request.extensions["sni_hostname"]))
        raise httpx2.ConnectError("refused") from ConnectionRefusedError()

    addresses = ["8.8.8.8", "2606:4700:4700::1111"]
    sender = WebhookPost(allow_loopback=False, resolve=lambda *_: addresses, transport=httpx2.MockTransport(refuse))
    assert sender.send("https://hooks.example.org/", {}, BODY).error == "The connection was refused."
    assert called == [(address, 443, "hooks.example.org") for address in addresses]


def test_stored_url_is_read_anew_by_the_same_rules():
    """A row that came in by another way, or before a rule was made, is no way around the rules."""
    for url in ("http://127.0.0.1:9/", "file:///etc/passwd", "https://user@hooks.example.org/"):
        assert WebhookPost(allow_loopback=False).send(url, {}, BODY).status is None


def test_slow_response_does_not_extend_the_total_time():
    done = threading.Event()

    def drips(connection):
        read_request(connection)
        for byte in b"HTTP/1.1 200 OK\r\nX-Slow: " + b"a" * 10_000:
            connection.sendall(bytes([byte]))
            if done.wait(0.05):
                return

    answer = posted_to(drips, seconds=0.5)
    done.set()
    assert (answer.status, answer.error) == (None, "No answer within 0.5 seconds.")


def test_silent_receiver_times_out():
    done = threading.Event()
    answer = posted_to(lambda _: done.wait(20), seconds=0.3)
    done.set()
    assert answer.error == "No answer within 0.3 seconds."


def test_receiver_that_does_not_read_times_out():
    done = threading.Event()
    with raw_receiver(lambda _: done.wait(20)) as port:
        sender = WebhookPost(allow_loopback=True, total_seconds=0.5)
        answer = sender.send(f"http://127.0.0.1:{port}/", {}, b"x" * 50_000_000)
        done.set()
    assert answer.error == "No answer within 0.5 seconds."


def test_stalled_tls_handshake_times_out(tmp_path):
    done = threading.Event()
    _, client = certificates(tmp_path, "127.0.0.1")
    with raw_receiver(lambda _: done.wait(20)) as port:
        answer = post(f"https://127.0.0.1:{port}/", seconds=0.3, tls=client)
        done.set()
    assert answer.error == "No answer within 0.3 seconds."


def test_endless_body_is_not_read():
    sent = []

    def floods(connection):
        read_request(connection)
        connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 100000000000\r\n\r\n")
        while len(sent) < 5000:
            connection.sendall(b"x" * 65536)
            sent.append(65536)

    assert posted_to(floods).status == 200
    assert sum(sent) < 50_000_000  # the kernel's buffers take some


@pytest.mark.parametrize(
    "chunks",
    [
        [b""],
        [b"\r\n\r\n"],
        [b"SSH-2.0-OpenSSH_9.2\r\n"],
        [b"HTTP/1.1 banana\r\n\r\n"],
        [b"HTTP/1.1 99999 OK\r\n\r\n"],
        [b"HTTP/1.1 -1 OK\r\n\r\n"],
        [b"HTTP/1.1 200 " + b"a" * 100_000],
        [b"HTTP/1.1 200 OK\r\n", *[b"X-%d: a\r\n" % n for n in range(1000)], b"\r\n"],
        [b"HTTP/1.1 200 OK\r\n", *[b"X-%d: " % n + b"a" * 60_000 + b"\r\n" for n in range(20)]],
        [b"\x00\xff" * 1000],
        [b"HTTP/1.1 100 Continue\r\n\r\n"] * 10_000,
    ],
    ids=lambda chunks: repr(chunks[0][:20]) + f"x{len(chunks)}",
)
def test_answer_that_is_not_http_is_a_failure_with_our_message(chunks):
    answer = posted_to(answering(*chunks))
    assert not answer.is_success
    assert answer.error in ("The answer was not HTTP.", "The connection failed.")


def test_text_of_the_receiver_is_never_stored():
    answer = posted_to(answering(b"HTTP/1.1 500 my secret reason\r\nX-Secret: hidden\r\n\r\nsecret body"))
    assert "secret" not in repr(answer)
    assert answer.status == 500


def test_continue_before_the_answer_is_passed_over():
    assert posted_to(answering(b"HTTP/1.1 100 Continue\r\n\r\n", OK)).status == 200


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        (b"120", 120.0),
        (b"0", 0.0),
        (b"-5", None),
        (b"Wed, 21 Oct 2026 07:28:00 GMT", None),
        (b"1e9", None),
        (b"", None),
    ],
)
def test_retry_after_is_read_in_seconds(header, seconds):
    answer = posted_to(answering(b"HTTP/1.1 503 Busy\r\nRetry-After: " + header + b"\r\n\r\n"))
    assert (answer.status, answer.retry_after_seconds) == (503, seconds)


def test_refused_connection_is_reported():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    assert post(f"http://127.0.0.1:{port}/").error == "The connection was refused."


def test_request_has_one_host_and_the_bodys_length():
    heads = []

    def talk(connection):
        heads.append(read_request(connection))
        connection.sendall(OK)

    with raw_receiver(talk) as port:
        assert post(f"http://127.0.0.1:{port}/a?b=c").is_success
    head, _, body = heads[0].partition(b"\r\n\r\n")
    assert head.split(b"\r\n") == [
        b"POST /a?b=c HTTP/1.1",
        f"Host: 127.0.0.1:{port}".encode(),
        b"Content-Length: 7",
        b"X-Test: 1",
        b"Connection: close",
    ]
    assert body == BODY


def test_request_target_is_path_and_query():
    assert parse_target("https://hooks.example.org/x?y", allow_loopback=False).path == "/x?y"
