"""How long ordinary pictures of one study take while callers of another send or ask for hostile photographs.

    python -m benchmarks.attack [--attack served|uploaded|slow_heads|slow_bodies|flood] [--rounds 5] [--seconds 12]

A fresh `tada serve` on SQLite with files and its default number of decoding children. `served`: four callers ask for
the costliest photograph there is, a progressive JPEG of 59 megapixels whose last scan is repeated as often as upload
takes it, at most 98 scans in all. `uploaded`: one phone sends, in turn, a HEIC of 190 kB in which 10,000 pictures name
one with 18,000 properties, and a WebP of 8 MB in whose EXIF 1,000 GPS entries share 7 MB. Two callers of the other
study each ask for ordinary pictures (12 megapixels, baseline), with a pause between two as of people who page through
a gallery. Quiet and attacked rounds alternate; p95 is the median of the rounds' p95.

The others run behind Caddy with docker/Caddyfile, from another address than the ordinary callers: `slow_heads` and
`slow_bodies` hold 1,200 connections on which a byte comes each second, and open one anew for each that ends; `flood`
asks with a wrong token from eight connections, as fast as it is answered.

Target: the attacked p95 is at most twice the quiet one, and every ordinary picture is served.
"""

import argparse
import contextlib
import dataclasses
import functools
import io
import itertools
import os
import socket
import struct
import subprocess
import sysconfig
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

from PIL import Image

from app.photos.jpeg import MAX_SCAN_PIXELS
from benchmarks.api import ROOT, Deployment, deployment, enrol
from benchmarks.api_load import BOUNDARY, Phone, meal_parts, percentiles
from benchmarks.processes import end

SIDE_PX = 7680
WANTED_SCANS = 98
ATTACKERS, OTHERS = 4, 2
CONTENT_TYPE = f"multipart/form-data; boundary={BOUNDARY.decode()}"
ATTACKS = ("served", "uploaded", "slow_heads", "slow_bodies", "flood")
Attack = Callable[
    [threading.Event, list[int]], None
]  # until the event; notes the statuses of the answers
PAUSE_SECONDS = 0.3
WIDTH_PX = 640
MOST_RATIO = 2.0
ATTACKERS_ADDRESS = "127.0.0.2"  # a trusted proxy on 127.0.0.1 tells the two apart
SLOW_CONNECTIONS, FLOODING_CONNECTIONS = 1200, 8
SLOW_REQUESTS = {
    "slow_heads": b"GET /healthz HTTP/1.1\r\nHost: x\r\nX-Slow: ",
    "slow_bodies": b"POST /v1/enrolments HTTP/1.1\r\nHost: x\r\nContent-Length: 100000\r\n\r\n",
}
FLOOD_REQUEST = b"GET /v1/me HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer wrong\r\n\r\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--attack", choices=ATTACKS, default="served")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--seconds", type=float, default=12.0, help="Of each quiet and each attacked round."
    )
    arguments = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors before")
    with (
        tempfile.TemporaryDirectory(prefix="tada-attack-") as name,
        deployment("sqlite", Path(name), TADA_TRUSTED_PROXIES="127.0.0.1") as server,
        proxied(server, Path(name)) as behind_proxy,
    ):
        target = server if arguments.attack in ("served", "uploaded") else behind_proxy
        if arguments.attack == "served":
            attacks = serving_attacks(server)
        elif arguments.attack == "uploaded":
            attacks = [uploading_attack(server)]
        else:
            attacks = connection_attacks(target, arguments.attack)
        return 0 if measure(target, attacks, arguments.rounds, arguments.seconds) else 1


@contextlib.contextmanager
def proxied(server: Deployment, folder: Path) -> Iterator[Deployment]:
    """The server behind Caddy with our own configuration."""
    ports = []
    for _ in range(2):
        with socket.create_server(("127.0.0.1", 0)) as probe:
            ports.append(probe.getsockname()[1])
    port, health_port = ports
    environment = os.environ | {
        "TADA_SITE": f"http://:{port}",
        "TADA_UPSTREAMS": f"to 127.0.0.1:{server.port}",
        "TADA_PROXY_HEALTH_PORT": str(health_port),
        "XDG_DATA_HOME": str(folder / "caddy"),
        "XDG_CONFIG_HOME": str(folder / "caddy"),
    }
    command = [
        Path(sysconfig.get_path("scripts")) / "caddy",
        "run",
        "--config",
        ROOT / "docker" / "Caddyfile",
    ]
    with (folder / "caddy.log").open("wb") as log:
        process = subprocess.Popen(
            [*command, "--adapter", "caddyfile"], env=environment, stdout=log, stderr=log
        )
        try:
            while socket.socket().connect_ex(("127.0.0.1", port)):
                time.sleep(0.1)
            yield dataclasses.replace(server, port=port)
        finally:
            end(process)


def connection_attacks(server: Deployment, kind: str) -> list[Attack]:
    """Connections that waste the server's time."""
    if kind == "flood":
        return [functools.partial(flood, server)] * FLOODING_CONNECTIONS
    return [functools.partial(hold_connections, server, SLOW_REQUESTS[kind])]


def connect(server: Deployment) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), 60.0, (ATTACKERS_ADDRESS, 0))


def hold_connections(
    server: Deployment, request: bytes, ending: threading.Event, answers: list[int]
) -> None:
    """Send a byte a second on each connection; a new one takes the place of each that is ended."""
    held: list[socket.socket] = []
    while not ending.is_set():
        while len(held) < SLOW_CONNECTIONS:
            held.append(connect(server))
            held[-1].sendall(request)
            held[-1].setblocking(False)
        for connection in list(held):
            try:
                connection.send(b"x")
                connection.recv(1000)  # an answer or the end: nothing else could come
            except BlockingIOError:
                continue
            except OSError:
                pass
            answers.append(408)
            connection.close()
            held.remove(connection)
        ending.wait(1.0)
    for connection in held:
        connection.close()


def flood(server: Deployment, ending: threading.Event, answers: list[int]) -> None:
    """Ask as fast as it is answered."""
    with connect(server) as connection:
        while not ending.is_set():
            connection.sendall(FLOOD_REQUEST)
            answer = connection.recv(65536)
            answers.append(int(answer.split()[1]))


def serving_attacks(server: Deployment) -> list[Attack]:
    """Callers who ask for the costly picture again and again."""
    costly, scans = costly_photograph()
    print(f"costly: {SIDE_PX} x {SIDE_PX}, {scans} scans, {len(costly) / 1e6:.1f} MB")
    pictures = [
        (token, uploaded(server, token, costly)) for token in enrol(server, ATTACKERS, "attack")
    ]
    return [functools.partial(attack, server, token, path) for token, path in pictures]


def uploading_attack(server: Deployment) -> Attack:
    """A phone that sends the hostile files in turn."""
    [token] = enrol(server, 1, "attack")
    files = [hostile_heic(), hostile_webp()]
    print(f"hostile: {', '.join(f'{len(file) / 1e6:.2f} MB' for file in files)}")

    def send(ending: threading.Event, answers: list[int]) -> None:
        phone = Phone(server.port, token)
        for file in itertools.cycle(files):
            if ending.is_set():
                return
            client_id = str(uuid.uuid4())
            body = meal_parts(client_id, file + os.urandom(16), is_stamped=False)
            status, _ = phone.ask("POST", "/v1/meals", *body, content_type=CONTENT_TYPE)
            answers.append(status)

    return send


def measure(server: Deployment, attacks: list[Attack], rounds: int, seconds: float) -> bool:
    """Print the table; whether the target holds."""
    others = enrol(server, OTHERS, "others")
    gallery = [(token, uploaded(server, token, ordinary_photograph())) for token in others]
    asked(server, gallery, seconds=3.0)  # warm
    quiet, attacked, statuses = [], [], []
    print(
        "| round | quiet p50 ms | quiet p95 ms | attacked p50 ms | attacked p95 ms | attacks accepted |"
    )
    print("|---|---|---|---|---|---|")
    for number in range(rounds):
        quiet.append(percentiles(asked(server, gallery, seconds=seconds))[:2])
        ending = threading.Event()
        answers: list[int] = []
        threads = [threading.Thread(target=each, args=(ending, answers)) for each in attacks]
        for thread in threads:
            thread.start()
        time.sleep(1.0)
        attacked.append(percentiles(asked(server, gallery, seconds=seconds))[:2])
        ending.set()
        for thread in threads:
            thread.join()
        statuses += answers
        cells = [f"{value:.0f}" for value in (*quiet[-1], *attacked[-1])]
        accepted = sum(status < 300 for status in answers)
        print(
            f"| {number + 1} | {' | '.join(cells)} | {accepted} of {len(answers)} |",
            flush=True,
        )
    (quiet_p50, quiet_p95), (attacked_p50, attacked_p95) = (
        [median(column) for column in zip(*each, strict=True)] for each in (quiet, attacked)
    )
    ratio = attacked_p95 / quiet_p95
    print(
        f"quiet p50 {quiet_p50:.0f} p95 {quiet_p95:.0f} ms; attacked p50 {attacked_p50:.0f} p95 {attacked_p95:.0f} ms"
    )
    print(f"ratio of p95 {ratio:.2f} (target: {MOST_RATIO}); load {os.getloadavg()[0]:.1f} after")
    return ratio <= MOST_RATIO


def asked(server: Deployment, gallery: list[tuple[str, str]], *, seconds: float) -> list[float]:
    """Latencies (s) of the ordinary pictures, asked for by all callers for so long. Raises if one is not served."""
    latencies: list[float] = []
    errors: list[str] = []
    deadline = time.monotonic() + seconds

    def page(token: str, path: str) -> None:
        phone = Phone(server.port, token)
        while time.monotonic() < deadline and not errors:
            started = time.perf_counter()
            status, body = phone.ask("GET", path)
            latencies.append(time.perf_counter() - started)
            if status != 200:
                errors.append(f"{status}: {body[:200]!r}")
            time.sleep(PAUSE_SECONDS)

    threads = [threading.Thread(target=page, args=each) for each in gallery]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise SystemExit(f"an ordinary picture was not served: {errors[0]}")
    return latencies


def attack(
    server: Deployment, token: str, path: str, ending: threading.Event, answers: list[int]
) -> None:
    """Ask for the costly picture again and again."""
    phone = Phone(server.port, token)
    while not ending.is_set():
        status, _ = phone.ask("GET", path)
        answers.append(status)
        if status != 200:
            ending.wait(0.2)


def uploaded(server: Deployment, token: str, photo: bytes) -> str:
    """Send a meal of this photograph: the address of its left picture."""
    client_id = str(uuid.uuid4())
    status, body = Phone(server.port, token).ask(
        "POST", "/v1/meals", *meal_parts(client_id, photo), content_type=CONTENT_TYPE
    )
    if status != 202:
        raise SystemExit(f"{status}: {body[:300]!r}")
    return f"/v1/meals/{client_id}/images/left?width={WIDTH_PX}"


def costly_photograph() -> tuple[bytes, int]:
    """The JPEG and its number of scans."""
    stream = io.BytesIO()
    Image.effect_noise((SIDE_PX // 8, SIDE_PX // 8), 40).convert("RGB").resize(
        (SIDE_PX, SIDE_PX)
    ).save(stream, "JPEG", progressive=True, quality=60)
    whole = stream.getvalue()
    last_scan = whole[whole.rindex(b"\xff\xda") : -2]
    own_scans = whole.count(b"\xff\xda")
    scans = min(WANTED_SCANS, MAX_SCAN_PIXELS // SIDE_PX**2)
    return whole[:-2] + last_scan * (scans - own_scans) + b"\xff\xd9", scans


def hostile_heic() -> bytes:
    """One picture with many properties, named by many, all of which the main one names."""

    def box(kind: bytes, *content: bytes) -> bytes:
        body = b"".join(content)
        return (len(body) + 8).to_bytes(4) + kind + body

    pictures, tile, properties = range(2, 10_002), 20_000, 255
    names = box(b"dimg", struct.pack(f">HH{len(pictures)}H", 1, len(pictures), *pictures))
    names += b"".join(box(b"dimg", struct.pack(">HHH", each, 1, tile)) for each in pictures)
    of_tile = struct.pack(">HB", tile, properties) + bytes([2]) * properties
    associations = bytes(4) + struct.pack(">L", 71) + struct.pack(">HBB", 1, 1, 1) + of_tile * 70
    size = box(b"ispe", struct.pack(">LLL", 0, 640, 480))
    iprp = box(b"iprp", box(b"ipco", size, box(b"free")), box(b"ipma", associations))
    infe = box(b"infe", b"\2\0\0\0" + struct.pack(">HH", 1, 0) + b"grid\0")
    iloc = box(b"iloc", b"\1\0\0\0\x44\0" + struct.pack(">HHHHHLL", 1, 1, 0, 0, 1, 0, 8))
    start = box(b"pitm", bytes(4), b"\0\1") + box(b"iinf", bytes(4), b"\0\1", infe) + iloc
    meta = box(b"meta", bytes(4), start, iprp, box(b"iref", bytes(4), names))
    return box(b"ftyp", b"heic\0\0\0\0mif1heic") + meta


def hostile_webp() -> bytes:
    """Its EXIF has one directory of 1,000 GPS entries, whose values are the same 20 MB."""
    size, shared, entries = 8_000_000, 7_000_000, 1000
    exif = (
        b"II*\0\x08\0\0\0"
        + struct.pack("<HHHLLL", 1, 0x8825, 4, 1, 26, 0)
        + struct.pack("<H", entries)
    )
    exif = (exif + struct.pack("<HHLL", 2, 7, shared, size - shared) * entries).ljust(size, b"x")
    stream = io.BytesIO()
    Image.effect_noise((640, 480), 40).convert("RGB").save(stream, "WEBP", exif=exif)
    return stream.getvalue()


def ordinary_photograph() -> bytes:
    """12 megapixels, as a phone takes them."""
    stream = io.BytesIO()
    Image.effect_noise((1000, 750), 40).convert("RGB").resize((4000, 3000)).save(
        stream, "JPEG", quality=90
    )
    return stream.getvalue()


if __name__ == "__main__":
    raise SystemExit(main())
