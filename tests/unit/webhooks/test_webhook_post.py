"""One POST, over real sockets: pinned to the checked address, within its time, and deaf to what receivers try."""

import asyncio
import itertools
import socket
import threading

import httpcore2
import pytest

from app.webhooks import webhook_post
from app.webhooks.webhook_post import MAX_BODY_BYTES, WebhookPost
from tests.support.receivers import certificates, raw_receiver, read_request, receiver
from tests.support.waiting import PATIENCE_SECONDS

BODY = b'{"a":1}'
OK = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n"


def post(url, *, seconds=PATIENCE_SECONDS, **options):
    return WebhookPost(allow_loopback=True, total_seconds=seconds, **options).send(url, {"X-Test": "1"}, BODY)


def posted_to(talk, seconds=PATIENCE_SECONDS):
    with raw_receiver(talk) as port:
        return post(f"http://127.0.0.1:{port}/", seconds=seconds)


def answering(*chunks):
    def talk(connection):
        read_request(connection)
        for chunk in chunks:
            connection.sendall(chunk)

    return talk


@pytest.mark.parametrize(("status", "is_success"), [(200, True), (299, True), (300, False)])
def test_success_is_2xx_and_nothing_else(status, is_success):
    with receiver(answer=status) as hook:
        answer = post(hook.url)
    assert (answer.status, answer.error, answer.is_success) == (status, None, is_success)
    (got,) = hook.received
    assert (got.path, got.body, got.headers["X-Test"]) == ("/hook?a=b", BODY, "1")
    assert got.headers["Host"] == f"127.0.0.1:{hook.port}"


@pytest.mark.parametrize("status", [301, 307])
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


@pytest.mark.parametrize(
    ("name", "host", "is_trusted"),
    [
        ("other.example.org", "hooks.example.org", True),
        ("127.0.0.1", "hooks.example.org", True),  # the address that is connected to: the URL's name counts
        ("127.0.0.1", "127.0.0.1", False),
    ],
)
def test_certificate_of_another_name_or_one_that_is_not_trusted_is_refused(tmp_path, name, host, is_trusted):
    server, client = certificates(tmp_path, name)
    with receiver(tls=server) as hook:
        trust = {"tls": client} if is_trusted else {}
        answer = post(f"https://{host}:{hook.port}/", resolve=lambda *_: ["127.0.0.1"], **trust)
    assert answer.status is None
    assert answer.error.startswith("The certificate was not accepted")
    assert hook.received == []


def test_name_that_resolves_to_a_private_address_later_is_not_called():
    """DNS rebinding: a public answer when the webhook was made, the loopback at its delivery."""
    answers = itertools.chain([["8.8.8.8"]], itertools.repeat(["127.0.0.1"]))
    with receiver() as inner:
        sender = WebhookPost(allow_loopback=False, resolve=lambda *_: next(answers))
        url = f"https://hooks.example.org:{inner.port}/"
        assert next(answers) == ["8.8.8.8"]
        answer = sender.send(url, {}, BODY)
    assert (answer.status, answer.error) == (None, "The URL leads to an address that is not public.")
    assert inner.received == []


def test_only_the_checked_addresses_are_connected_to_and_a_stored_url_is_read_anew_by_the_same_rules(monkeypatch):
    called = []

    async def refuse(_, host, port, *__):
        called.append((host, port))
        try:
            raise ConnectionRefusedError
        except OSError as error:  # as the library has it
            raise httpcore2.ConnectError from error

    monkeypatch.setattr(httpcore2.AnyIOBackend, "connect_tcp", refuse)
    addresses = ["8.8.8.8", "2606:4700:4700::1111"]
    sender = WebhookPost(allow_loopback=False, resolve=lambda *_: addresses)
    assert sender.send("https://hooks.example.org/", {}, BODY).error == "The connection was refused."
    assert called == [(address, 443) for address in addresses]
    # A row that came in by another way, or before a rule was made, is no way around the rules.
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


@pytest.mark.parametrize("size", [7, 50_000_000])  # the second is not read: it fills the kernel's buffers
def test_receiver_that_is_silent_or_does_not_read_times_out(size):
    done = threading.Event()
    with raw_receiver(lambda _: done.wait(PATIENCE_SECONDS)) as port:
        sender = WebhookPost(allow_loopback=True, total_seconds=0.3)
        answer = sender.send(f"http://127.0.0.1:{port}/", {}, b"x" * size)
        done.set()
    assert answer.error == "No answer within 0.3 seconds."


@pytest.mark.parametrize(
    "chunks",
    [
        [b""],
        [b"HTTP/1.1 banana\r\n\r\n"],
        [b"HTTP/1.1 200 " + b"a" * 100_000],
        [b"HTTP/1.1 200 OK\r\n", *[b"X-%d: a\r\n" % n for n in range(1000)], b"\r\n"],
        [b"HTTP/1.1 100 Continue\r\n\r\n"] * 10_000,
    ],
    ids=lambda chunks: repr(chunks[0][:20]) + f"x{len(chunks)}",
)
def test_answer_that_is_not_http_is_a_failure_with_our_message(chunks):
    answer = posted_to(answering(*chunks))
    assert not answer.is_success
    assert answer.error in ("The answer was not HTTP.", "The connection failed.")


def test_text_of_the_receiver_is_not_stored_a_continue_is_passed_over_and_a_refusal_is_reported():
    answer = posted_to(answering(b"HTTP/1.1 500 my secret reason\r\nX-Secret: hidden\r\n\r\nsecret body"))
    assert "secret" not in repr(answer)
    assert answer.status == 500
    assert posted_to(answering(b"HTTP/1.1 100 Continue\r\n\r\n", OK)).status == 200
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    assert post(f"http://127.0.0.1:{port}/").error == "The connection was refused."


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        (b"120", 120.0),
        (b"0", 0.0),
        (b"-5", None),
        (b"Wed, 21 Oct 2026 07:28:00 GMT", None),
    ],
)
def test_retry_after_is_read_in_seconds(header, seconds):
    answer = posted_to(answering(b"HTTP/1.1 503 Busy\r\nRetry-After: " + header + b"\r\n\r\n"))
    assert (answer.status, answer.retry_after_seconds) == (503, seconds)


def post_each(urls, *, seconds=10.0, **options):
    """The answers to POSTs that are sent one after the other by kept connections."""

    async def send_each():
        async with WebhookPost(allow_loopback=True, total_seconds=seconds, **options).kept_connections() as send:
            return [await send(url, {"X-Test": "1"}, BODY) for url in urls]

    return asyncio.run(send_each())


class Keeping:
    """A receiver that answers all requests of a connection; counts connections."""

    def __init__(self, answer):
        self.answer, self.connections = answer, 0

    def __call__(self, connection):
        self.connections += 1
        while connection.recv(1, socket.MSG_PEEK):
            read_request(connection)
            connection.sendall(self.answer)


@pytest.mark.parametrize(("size", "connections"), [(2, 1), (4 * MAX_BODY_BYTES, 5)])
def test_kept_connection_serves_many_posts_but_not_after_a_long_body(size, connections):
    keeping = Keeping(b"HTTP/1.1 201 Created\r\nContent-Length: %d\r\n\r\n" % size + bytes(size))
    with raw_receiver(keeping) as port:
        answers = post_each([f"http://127.0.0.1:{port}/{number}" for number in range(5)])
    assert [answer.status for answer in answers] == [201] * 5
    assert keeping.connections == connections


def test_connection_of_one_name_is_not_used_for_another_name_at_the_same_address(tmp_path):
    server, client = certificates(tmp_path, "hooks.example.org")
    with receiver(tls=server) as hook:
        urls = [f"https://{name}.example.org:{hook.port}/" for name in ("hooks", "other", "hooks")]
        answers = post_each(urls, resolve=lambda *_: ["127.0.0.1"], tls=client)
    assert [answer.is_success for answer in answers] == [True, False, True]
    assert answers[1].error.startswith("The certificate was not accepted")
    assert len(hook.received) == 2


class Line:
    """A receiver that talks with each connection in turn as the next of `talks` does."""

    def __init__(self, *talks):
        self.talks = iter(talks)

    def __call__(self, connection):
        next(self.talks)(connection)


def keep(connection, answer=OK):
    while connection.recv(1, socket.MSG_PEEK):
        read_request(connection)
        connection.sendall(answer)


def keep_once(connection, *chunks):
    """Answer one request; read the second, send these chunks, and end the connection."""
    read_request(connection)
    connection.sendall(OK)
    read_request(connection)
    for chunk in chunks:
        connection.sendall(chunk)


NOT_HTTP = "The answer was not HTTP."


@pytest.mark.parametrize(
    ("talks", "errors"),
    [
        ([keep_once, keep], [None, None]),
        ([keep_once, read_request, keep], [None, NOT_HTTP, None]),  # the second connection ends unanswered too
    ],
)
def test_post_on_a_connection_that_ends_unanswered_is_sent_once_more_by_a_new_one(talks, errors):
    with raw_receiver(Line(*talks)) as port:
        answers = post_each([f"http://127.0.0.1:{port}/"] * len(errors))
    assert [answer.error for answer in answers] == errors


def test_status_counts_though_the_body_stalls(monkeypatch):
    monkeypatch.setattr(webhook_post, "BODY_SECONDS", 0.2)
    ended = []

    def stall(connection):
        answering(b"HTTP/1.1 410 Gone\r\nContent-Length: 10\r\n\r\nabc")(connection)
        ended.append(connection.recv(1))  # until the connection is closed

    with raw_receiver(Line(stall, keep)) as port:
        answers = post_each([f"http://127.0.0.1:{port}/"] * 2, seconds=PATIENCE_SECONDS)
    assert [answer.status for answer in answers] == [410, 200]
    assert ended == [b""]


def test_name_of_a_private_address_is_refused_each_time_and_one_that_failed_is_looked_up_for_a_new_connection_only():
    urls = ["https://push.example.org/a", "https://push.example.org/b"]
    answers = post_each(urls, resolve=lambda *_: ["169.254.169.254"])
    assert [answer.error for answer in answers] == ["The URL leads to an address that is not public."] * 2
    lookups = iter([[], ["127.0.0.1"]])
    with raw_receiver(Keeping(OK)) as port:
        answers = post_each([f"http://127.0.0.1:{port}/"] * 3, resolve=lambda *_: next(lookups))
    assert [answer.status for answer in answers] == [None, 200, 200]
    assert answers[0].error == "The name in the URL does not resolve."


def test_silent_host_holds_no_other_post_up():
    begun, may_answer = threading.Event(), threading.Event()

    async def send_both():
        async with WebhookPost(allow_loopback=True, total_seconds=PATIENCE_SECONDS).kept_connections() as send:
            slow = asyncio.create_task(send(f"http://127.0.0.1:{silent}/", {}, BODY))
            await asyncio.to_thread(begun.wait, PATIENCE_SECONDS)
            quick = await send(hook.url, {}, BODY)
            assert not slow.done()
            may_answer.set()
            return quick, await slow

    def answer_late(connection):
        read_request(connection)
        begun.set()
        may_answer.wait(PATIENCE_SECONDS)
        connection.sendall(OK)

    with raw_receiver(answer_late) as silent, receiver() as hook:
        quick, slow = asyncio.run(send_both())
    assert (quick.status, slow.status) == (204, 200)


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
