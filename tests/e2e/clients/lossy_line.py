"""A line between client and server that drops a share of the requests, by a seeded choice."""

import http.server
import random
import re
import socket
import threading
from contextlib import contextmanager

import httpx2

LARGE_BODY = 256 * 1024
HOP_BY_HOP = {"connection", "keep-alive", "transfer-encoding", "content-length", "date", "server"}


class LossyLine(http.server.ThreadingHTTPServer):
    """Drops requests `before` they reach the server, or `after` its answer, of which a half arrives if `inside`.

    loses_first_answers: of each address the first answer never arrives, whatever the share. broken_bodies: of the next
    requests with a large body, so many bytes reach the server before the line breaks. unknown: addresses that the
    server, as an older one, does not know. photograph_bytes: of photographs, in all
    requests so far.
    """

    daemon_threads = True

    def __init__(self, target, share, seed, *, loses_first_answers=False, broken_bodies=(), unknown=None):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.address = f"http://127.0.0.1:{self.server_port}"
        self.client = httpx2.Client(base_url=target, timeout=90)
        self.requests = 0
        self.dropped = {"before": 0, "after": 0, "inside": 0}
        self._share = share
        self._random = random.Random(seed)
        self._lock = threading.Lock()
        self._loses_first_answers = loses_first_answers
        self._asked = set()
        self.broken_bodies = list(broken_bodies)
        self.unknown = unknown
        self.photograph_bytes = 0

    def fate(self, asked):
        """How the next request, such as "GET /v1/me", is dropped; None: it is not."""
        with self._lock:
            self.requests += 1
            if self._loses_first_answers and asked not in self._asked:
                self._asked.add(asked)
                self.dropped["after"] += 1
                return "after"
            if self._random.random() >= self._share:
                return None
            fate = self._random.choice(["before", "after", "inside"])
            self.dropped[fate] += 1
            return fate


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def _forward(self):
        fate = self.server.fate(f"{self.command} {self.path}")
        if fate == "before":
            self._break_off()
            return
        length = int(self.headers.get("Content-Length", 0))
        if length > LARGE_BODY and self.server.broken_bodies:
            self._break_inside_body(self.server.broken_bodies.pop(0))
            return
        body = self.rfile.read(length)
        self.server.photograph_bytes += length if "/images/" in self.path else 0
        if self.server.unknown is not None and re.search(self.server.unknown, self.path):
            self.send_error(404)
            return
        headers = {name: value for name, value in self.headers.items() if name.lower() not in {"host", "connection"}}
        answer = self.server.client.request(self.command, self.path, headers=headers, content=body)
        if fate == "after":
            self._break_off()
            return
        self.send_response_only(answer.status_code)
        for name, value in answer.headers.items():
            if name.lower() not in HOP_BY_HOP:
                self.send_header(name, value)
        if answer.status_code not in {204, 304}:
            self.send_header("Content-Length", str(len(answer.content)))
        self.end_headers()
        self.wfile.write(answer.content[: len(answer.content) // 2] if fate == "inside" else answer.content)
        if fate == "inside":
            self._break_off()

    do_GET = do_POST = do_PUT = do_PATCH = do_DELETE = _forward  # noqa: N815  # as http.server calls them

    def _break_inside_body(self, count):
        head = f"{self.command} {self.path} HTTP/1.1\r\n{self.headers}".encode()
        url = self.server.client.base_url
        with socket.create_connection((url.host, url.port)) as connection:
            connection.sendall(head.replace(b"\n", b"\r\n").replace(b"\r\r\n", b"\r\n") + self.rfile.read(count))
            connection.shutdown(socket.SHUT_WR)  # closed at once, the server would give up what it has not yet read
            while connection.recv(LARGE_BODY):
                """Wait until it has closed the connection."""
        self.server.photograph_bytes += count
        self._break_off()

    def _break_off(self):
        self.close_connection = True
        self.connection.shutdown(socket.SHUT_RDWR)

    def log_message(self, *_):
        pass


@contextmanager
def lossy_line(target, share=0.2, seed=1, **choices):
    with LossyLine(target, share, seed, **choices) as line:
        thread = threading.Thread(target=line.serve_forever, daemon=True)
        thread.start()
        try:
            yield line
        finally:
            line.shutdown()
            thread.join(10)
            line.client.close()
