"""The load of benchmarks/api.py, in a process of its own: prepared bodies over raw sockets, a thread a phone.

    python -m benchmarks.api_load < order.json

The order names what to do (upload, flow, poll, disk, bucket), at what concurrency and how often; the answer is one
JSON object: wall seconds, own CPU seconds, latencies (s), errors. `disk` and `bucket` are the yardsticks: the same
bytes written and synced to files, or put to the bucket, by as many threads.
"""

import hashlib
import json
import os
import resource
import socket
import sys
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import obstore
from obstore.store import S3Store

BOUNDARY = b"0123456789abcdef"
STAMP_BYTES = 36  # a JPEG comment of ours, other in every photograph that is sent
PATIENCE_SECONDS = 120.0
BUSY, AGAIN_SECONDS = 503, 0.5


@dataclass
class Outcome:
    """Of one run. seconds: wall. sent: client ids -> SHA-256 of left and right, as they were sent."""

    seconds: float = 0.0
    cpu_seconds: float = 0.0
    latencies: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    sent: dict[str, list[str]] = field(default_factory=dict)


class Phone:
    """One keep-alive connection."""

    def __init__(self, port: int, token: str) -> None:
        self._port, self._token = port, token
        self._socket: socket.socket | None = None

    def ask(
        self, method: str, path: str, *body: bytes, content_type: str = ""
    ) -> tuple[int, bytes]:
        """Send a request; status and body of the answer."""
        if self._socket is None:
            self._socket = socket.create_connection(("127.0.0.1", self._port), PATIENCE_SECONDS)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        head = f"{method} {path} HTTP/1.1\r\nHost: tada\r\nAuthorization: Bearer {self._token}\r\n"
        if body:
            head += f"Content-Type: {content_type}\r\nContent-Length: {sum(map(len, body))}\r\n"
        try:
            self._socket.sendall(head.encode() + b"\r\n")
            for piece in body:
                self._socket.sendall(piece)
            return self._answer(self._socket)
        except OSError:
            self._socket.close()
            self._socket = None
            raise

    def _answer(self, sock: socket.socket) -> tuple[int, bytes]:
        data = b""
        while b"\r\n\r\n" not in data:
            piece = sock.recv(65536)
            if not piece:
                raise ConnectionError("the server closed the connection")
            data += piece
        head, _, body = data.partition(b"\r\n\r\n")
        lines = head.lower().split(b"\r\n")
        length = next(
            (int(line.split(b":")[1]) for line in lines if line.startswith(b"content-length:")), 0
        )
        while len(body) < length:
            body += sock.recv(65536)
        if b"connection: close" in lines:
            sock.close()
            self._socket = None
        return int(head.split()[1]), body


def stamped(photo: bytes, stamp: str) -> tuple[bytes, bytes]:
    """A JPEG in two pieces: its start with a comment that makes it another file, and the rest, which is not copied."""
    return photo[:2] + b"\xff\xfe" + (2 + STAMP_BYTES).to_bytes(2, "big") + stamp.encode(), photo[
        2:
    ]


def meal_parts(
    client_id: str, photo: bytes, right: bytes | None = None, *, is_stamped: bool = True
) -> list[bytes]:
    """The body of POST /v1/meals in pieces. right: another one than `photo`, which else is both.

    is_stamped: the photographs are JPEGs, and each gets other bytes.
    """
    metadata = {
        "id": client_id,
        "captured_at": "2026-11-20T12:30:00+08:00",
        "time_zone": "Asia/Shanghai",
    }
    parts = [
        b'--%s\r\nContent-Disposition: form-data; name="metadata"\r\nContent-Type: application/json\r\n\r\n%s\r\n'
        % (BOUNDARY, json.dumps(metadata).encode())
    ]
    for number, slot in enumerate((b"left", b"right")):
        head = (
            b'--%s\r\nContent-Disposition: form-data; name="%s"; filename="p.jpg"\r\n'
            b"Content-Type: image/jpeg\r\n\r\n"
        )
        view = right if number and right is not None else photo
        file = stamped(view, f"{client_id[:-1]}{number}") if is_stamped else (view,)
        parts += [head % (BOUNDARY, slot), *file, b"\r\n"]
    return [*parts, b"--%s--\r\n" % BOUNDARY]


def run_threads(count: int, times: int, job: Callable[[int, int], None], outcome: Outcome) -> None:
    """`times` jobs by `count` threads; a job gets its thread's number and its own."""
    numbers = iter(range(times))
    lock, barrier = threading.Lock(), threading.Barrier(count + 1)

    def work(thread: int) -> None:
        barrier.wait()
        while True:
            with lock:
                number = next(numbers, None)
            if number is None:
                return
            started = time.perf_counter()
            try:
                job(thread, number)
            except Exception as error:  # noqa: BLE001  # whatever it is, it is a meal that was not taken
                outcome.errors.append(f"{type(error).__name__}: {error}"[:300])
            outcome.latencies.append(time.perf_counter() - started)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    barrier.wait()
    started = time.perf_counter()
    for thread in threads:
        thread.join()
    outcome.seconds = time.perf_counter() - started


def upload(order: dict[str, Any], outcome: Outcome) -> None:
    """Meals, as fast as the phones are answered. pairs: of photographs, in turn; else `photo` twice."""
    pairs = order.get("pairs") or [[order["photo"], order["photo"]]]
    photographs = [[Path(path).read_bytes() for path in pair] for pair in pairs]
    phones = [Phone(order["port"], token) for token in order["tokens"][: order["concurrency"]]]

    def send(thread: int, number: int) -> None:
        client_id = str(uuid.uuid4())
        send_meal(phones[thread], client_id, *photographs[number % len(photographs)])
        outcome.sent[client_id] = []

    run_threads(order["concurrency"], order["times"], send, outcome)


def send_meal(phone: Phone, client_id: str, photo: bytes, right: bytes | None = None) -> None:
    """One meal, sent again where the server is too busy; another answer than 202 raises."""
    content_type = f"multipart/form-data; boundary={BOUNDARY.decode()}"
    parts = meal_parts(client_id, photo, right)
    status, body = phone.ask("POST", "/v1/meals", *parts, content_type=content_type)
    while status == BUSY:
        time.sleep(AGAIN_SECONDS)
        status, body = phone.ask("POST", "/v1/meals", *parts, content_type=content_type)
    if status != 202:
        raise RuntimeError(f"{status}: {body[:200]!r}")


def flow(order: dict[str, Any], outcome: Outcome) -> None:
    """Meals at a fixed rate, whether the ones before are answered or not; a latency begins when the meal was due."""
    photo = Path(order["photo"]).read_bytes()
    phones = [Phone(order["port"], token) for token in order["tokens"]]
    due = [number / order["per_second"] for number in range(order["times"])]
    started = time.perf_counter() + 0.5

    def send(thread: int, number: int) -> None:
        time.sleep(max(0.0, started + due[number] - time.perf_counter()))
        client_id = str(uuid.uuid4())
        send_meal(phones[thread], client_id, photo)
        outcome.sent[client_id] = [
            hashlib.sha256(b"".join(stamped(photo, f"{client_id[:-1]}{slot}"))).hexdigest()
            for slot in (0, 1)
        ]
        late.append(time.perf_counter() - started - due[number])

    late: list[float] = []
    run_threads(len(phones), order["times"], send, outcome)
    outcome.latencies = late


def poll(order: dict[str, Any], outcome: Outcome) -> None:
    """Status of meals, as fast as the phones are answered; each asks for its own."""
    phones = [Phone(order["port"], token) for token in order["tokens"][: order["concurrency"]]]

    def ask(thread: int, _: int) -> None:
        status, body = phones[thread].ask("GET", f"/v1/meals/{order['meals'][thread]}")
        if status != 200:
            raise RuntimeError(f"{status}: {body[:200]!r}")

    run_threads(order["concurrency"], order["times"], ask, outcome)


def disk(order: dict[str, Any], outcome: Outcome) -> None:
    """The yardstick: two files a meal, written and synced, and no more."""
    photo, folder = Path(order["photo"]).read_bytes(), Path(order["folder"])

    def write(_: int, number: int) -> None:
        for slot in (0, 1):
            handle = os.open(
                folder / f"{number}-{slot}-{uuid.uuid4().hex}", os.O_WRONLY | os.O_CREAT | os.O_EXCL
            )
            try:
                written = 0
                while written < len(photo):
                    written += os.write(handle, memoryview(photo)[written:])
                os.fsync(handle)
            finally:
                os.close(handle)

    run_threads(order["concurrency"], order["times"], write, outcome)


def bucket(order: dict[str, Any], outcome: Outcome) -> None:
    """The yardstick: two puts a meal, and no more."""
    photo = Path(order["photo"]).read_bytes()
    store = S3Store.from_url(
        order["url"],
        endpoint=order["endpoint"],
        access_key_id=order["access_key_id"],
        secret_access_key=order["secret_access_key"],
        region="us-east-1",
        client_options={"allow_http": True},
    )

    def put(_: int, number: int) -> None:
        for slot in (0, 1):
            obstore.put(
                store, f"yardstick/{number}-{slot}-{uuid.uuid4().hex}", photo, use_multipart=False
            )

    run_threads(order["concurrency"], order["times"], put, outcome)


ORDERS: dict[str, Callable[[dict[str, Any], Outcome], None]] = {
    "upload": upload,
    "flow": flow,
    "poll": poll,
    "disk": disk,
    "bucket": bucket,
}


def percentiles(values: Sequence[float]) -> tuple[float, float, float]:
    """p50, p95 and p99 in milliseconds."""
    ordered = sorted(values)
    p50, p95, p99 = (
        1000 * ordered[min(len(ordered) - 1, int(share * len(ordered)))]
        for share in (0.5, 0.95, 0.99)
    )
    return p50, p95, p99


def main() -> None:
    order, outcome = json.load(sys.stdin), Outcome()
    before = resource.getrusage(resource.RUSAGE_SELF)
    ORDERS[order["do"]](order, outcome)
    after = resource.getrusage(resource.RUSAGE_SELF)
    outcome.cpu_seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    json.dump(asdict(outcome), sys.stdout)


if __name__ == "__main__":
    main()
