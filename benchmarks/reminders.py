"""Measure one worker that reminds many phones, all due at the same moment: its time, processor time and memory.

    python -m benchmarks.reminders [--phones 10000] [--services 3] [--answer-ms 100] [--kind sqlite]

The worker's chore itself, on a fresh database, sends by TLS to push services of our own: processes on 127.0.0.1 that
answer after --answer-ms. A phone counts once its message was answered. On this machine the services share the
processors with the worker; `services s` is their processor time.
"""

import argparse
import asyncio
import contextlib
import multiprocessing
import resource
import ssl
import tempfile
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path

from app.core.settings import Settings
from app.db.session import Database
from app.extras.reminders.send_reminders import SendReminders
from app.extras.reminders.web_push import text_of
from app.operations.prepare import prepare
from app.people.access.secret_box import SecretBox
from app.people.models import Device, Participant, PushSubscription
from app.people.studies import create_study
from app.webhooks.webhook_post import WebhookPost
from benchmarks.databases import database_url
from tests.support.push_services import Browser
from tests.support.receivers import certificates

DUE = datetime(2026, 11, 27, 12, 30, tzinfo=UTC)
RECEIVERS = 50  # different browsers; each message has its own key all the same
PATIENCE_SECONDS = 3600
CONTACT = "mailto:benchmark@example.org"


@dataclass(frozen=True)
class Service:
    """A push service in a process of its own."""

    port: int
    control: Connection

    def counts(self) -> tuple[int, int, float]:
        """Return its messages, its connections, and its processor time in seconds so far."""
        self.control.send("counts")
        messages, connections, seconds = self.control.recv()
        return messages, connections, seconds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--phones", type=int, default=10_000)
    parser.add_argument(
        "--services", type=int, default=3, help="push services, as of Apple, Google and Mozilla"
    )
    parser.add_argument(
        "--answer-ms", type=float, default=100.0, help="time that a push service takes to answer"
    )
    parser.add_argument("--kind", choices=("sqlite", "postgresql"), default="sqlite")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with (
            database_url(arguments.kind, folder) as url,
            push_services(arguments, folder) as services,
        ):
            print(measured(url, folder, services, arguments.phones))
    return 0


def measured(url: str, folder: Path, services: list[Service], phones: int) -> str:
    database = Database(url)
    settings = Settings(data_dir=folder)
    prepare(database, settings)
    subscribe(database, services, phones)
    tls = ssl.create_default_context(cafile=str(folder / "server.pem"))
    post = WebhookPost(allow_loopback=True, tls=tls)
    chore = SendReminders(database, SecretBox("k" * 40), post, CONTACT, now=lambda: DUE)
    before_mb, before = peak_mb(), time.process_time()
    begun = time.perf_counter()
    chore.run()
    chore.wait_until_idle(PATIENCE_SECONDS)
    seconds = time.perf_counter() - begun
    spent = time.process_time() - before
    counts = [service.counts() for service in services]
    database.dispose()
    sent, connections = (sum(count[place] for count in counts) for place in (0, 1))
    return (
        f"sent {sent} of {phones}, {seconds:.1f} s, processor {spent:.1f} s ({1000 * spent / phones:.2f} ms each), "
        f"peak {before_mb:.0f} -> {peak_mb():.0f} MB, {connections} connections, "
        f"services {sum(count[2] for count in counts):.1f} s of processor time"
    )


def subscribe(database: Database, services: list[Service], phones: int) -> None:
    """Enrol phones, all due at DUE."""
    study = create_study(database, code="many", name="Many")
    receivers = [Browser().receiver for _ in range(RECEIVERS)]
    people: list[Participant] = []
    devices: list[Device] = []
    subscriptions: list[PushSubscription] = []
    for number in range(phones):
        person = Participant(id=uuid.uuid4(), study_id=study.id, code=f"P{number}", created_at=DUE)
        device = Device(id=uuid.uuid4(), participant_id=person.id, name="phone", enrolled_at=DUE)
        receiver, port = receivers[number % RECEIVERS], services[number % len(services)].port
        people.append(person)
        devices.append(device)
        subscriptions.append(
            PushSubscription(
                device_id=device.id,
                endpoint=f"https://127.0.0.1:{port}/send/{device.id}",
                public_key=text_of(receiver.public_key),
                auth=text_of(receiver.auth),
                times=["12:30"],
                after_meal=True,
                time_zone="UTC",
                quiet_from_minutes=0,
                quiet_until_minutes=0,
                next_at=DUE,
                created_at=DUE,
            )
        )
    with database.write() as session:
        for rows in (people, devices, subscriptions):
            session.add_all(rows)
            session.flush()


@contextlib.contextmanager
def push_services(arguments: argparse.Namespace, folder: Path) -> Iterator[list[Service]]:
    """Start the push services; `folder` then holds their certificate."""
    certificates(folder, "127.0.0.1")
    context = multiprocessing.get_context("spawn")
    services, processes = [], []
    for _ in range(arguments.services):
        here, there = context.Pipe()
        process = context.Process(
            target=run_service,
            args=(there, folder / "server.pem", arguments.answer_ms / 1000),
            daemon=True,
        )
        process.start()
        processes.append(process)
        services.append(Service(here.recv(), here))
    yield services
    for process in processes:
        process.terminate()
        process.join()


def run_service(control: Connection, certificate: Path, answer_seconds: float) -> None:
    """Run a push service that accepts every message. It sends its port, then its counts whenever it is asked."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    messages = connections = 0

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal messages, connections
        connections += 1
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                head = (await reader.readuntil(b"\r\n\r\n")).lower()
                (length,) = (
                    int(line.split(b":")[1])
                    for line in head.split(b"\r\n")
                    if line.startswith(b"content-length")
                )
                await reader.readexactly(length)
                await asyncio.sleep(answer_seconds)
                messages += 1
                writer.write(b"HTTP/1.1 201 Created\r\nContent-Length: 0\r\n\r\n")
                await writer.drain()
                if b"connection: close" in head:
                    break
            writer.close()
            await writer.wait_closed()

    async def serve() -> None:
        server = await asyncio.start_server(answer, "127.0.0.1", 0, ssl=context, backlog=500)
        control.send(server.sockets[0].getsockname()[1])
        while True:
            await asyncio.to_thread(control.recv)
            control.send((messages, connections, time.process_time()))

    with contextlib.suppress(EOFError, KeyboardInterrupt):
        asyncio.run(serve())


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    raise SystemExit(main())
