"""`tada serve --processes 2`: a killed process is replaced, metrics are sums, and all end in order."""

import contextlib
import os
import pathlib
import re
import shutil
import signal
import socket

import httpx2
import pytest

from tests.e2e.processes import Server
from tests.support.waiting import PATIENCE_SECONDS, wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not pathlib.Path("/proc/self/task").exists(), reason="needs Linux' /proc"),
]
AT_ONCE = 12  # requests, of which each process has some
BODY = b'{"code": "none", "device_name": "phone"}'
HEAD = b"POST /v1/enrolments HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n" % len(
    BODY
)


class TwoProcesses(Server):
    """The server, and which of its processes has which connection."""

    def __init__(self, folder, template, worker="--no-worker", **variables):
        self.scratch = folder / "scratch"
        self.scratch.mkdir()
        variables |= {
            "TADA_STALL_SECONDS": str(PATIENCE_SECONDS),
            "TADA_LOG_LEVEL": "INFO",
            "TMPDIR": str(self.scratch),
        }
        super().__init__(folder, worker, "--processes", "2", **variables)
        self.data_dir.mkdir()
        shutil.copyfile(template, self.data_dir / "tada.sqlite3")

    def pids(self):
        children = pathlib.Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return {int(pid) for pid in children if b"spawn_main" in pathlib.Path(f"/proc/{pid}/cmdline").read_bytes()}

    def wait_for_two(self, besides=()):
        """The ids of both once they serve. besides: of processes that are dead."""

        def two():
            ready = {pid for pid in self.pids() - set(besides) if self._accepts(pid)}
            return len(ready) == 2 and ready

        return wait_until(two, lambda: self.log)

    def _accepts(self, pid):
        """True if a process waits for connections: epoll watches the listening socket."""
        with contextlib.suppress(OSError):
            listening = {link for link in _links(self.process.pid) if link in _links(pid)}
            for info in pathlib.Path(f"/proc/{pid}/fdinfo").iterdir():
                watched = re.findall(r"tfd:\s+(\d+)", info.read_text())
                if any(str(pathlib.Path(f"/proc/{pid}/fd/{number}").readlink()) in listening for number in watched):
                    return True
        return False

    def connect(self):
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_SECONDS)

    def owner_of(self, connection):
        """The process that has accepted a connection."""
        port = connection.getsockname()[1]

        def owner():
            rows = [line.split() for line in pathlib.Path("/proc/net/tcp").read_text().splitlines()[1:]]
            ends = f"0100007F:{self.port:04X}", f"0100007F:{port:04X}"
            inodes = [row[9] for row in rows if (row[1], row[2]) == ends]
            for pid in self.pids():
                with contextlib.suppress(OSError):
                    if inodes and f"socket:[{inodes[0]}]" in _links(pid):
                        return pid
            return None

        return wait_until(owner, "a process that accepts the connection")

    def half_requests(self):
        """AT_ONCE requests of which half the body has come, by the process that has them; each has some."""

        def of_both():
            owned = {}
            for _ in range(AT_ONCE):
                connection = self.connect()
                connection.sendall(HEAD + BODY[:10])
                owned.setdefault(self.owner_of(connection), []).append(connection)
            if len(owned) == 2:
                return owned
            for connection in owned.popitem()[1]:
                connection.close()
            return None

        return wait_until(of_both, "both processes to take connections", interval_seconds=0.2)


def wait_for_log(server, event):
    wait_until(lambda: event in server.log, lambda: f"{event} in:\n{server.log}")


def _links(pid):
    """The sockets that a process has open."""
    links = set()
    for entry in pathlib.Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            links.add(str(entry.readlink()))
    return {link for link in links if link.startswith("socket:")}


def status_of(connection):
    answer = connection.recv(65536)
    return int(answer.split()[1]) if answer else None


@pytest.fixture(scope="module")
def server(tmp_path_factory, sqlite_template):
    running = TwoProcesses(
        tmp_path_factory.mktemp("processes"),
        sqlite_template,
    )
    running.start()
    running.wait_until_ready()
    running.wait_for_two()
    yield running
    running.stop()


def test_metrics_are_sums_whichever_process_answers(server):
    line = r'tada_http_request_seconds_count\{method="GET",route="/healthz",status="2xx"\} ([0-9.]+)'

    def counted():
        text = httpx2.get(f"{server.address}/metrics", timeout=PATIENCE_SECONDS).text
        count = re.search(line, text)
        assert 'tada_build{part="api"' in text
        assert len(re.findall(r"process_resident_memory_bytes\{", text)) == 3  # of the parent too
        return float(count[1]) if count else 0.0

    before = counted()
    for _ in range(20):
        httpx2.get(f"{server.address}/healthz", timeout=PATIENCE_SECONDS)
    wait_until(lambda: counted() - before >= 20.0, "the last to be counted, once it is answered")
    assert [counted() - before for _ in range(10)] == [20.0] * 10


def test_killed_process_is_replaced_and_the_others_requests_go_on(server):
    owned = server.half_requests()
    (killed, lost), (other, kept) = owned.items()
    os.kill(killed, signal.SIGKILL)
    server.wait_for_two(besides=[killed])
    assert other in server.pids()
    again = [server.connect() for _ in lost]
    for connection in [*kept, *again]:
        connection.sendall(BODY[10:] if connection in kept else HEAD + BODY)
    assert {status_of(connection) for connection in [*kept, *again]} <= {404, 429}
    for connection in lost:
        with contextlib.suppress(ConnectionResetError):
            assert status_of(connection) is None
    for connection in [*lost, *kept, *again]:
        connection.close()
    assert server.log.count(f"[{killed}] died") == 1


def test_sigterm_ends_all_once_their_requests_are_answered(tmp_path, sqlite_template):
    server = TwoProcesses(tmp_path, sqlite_template, "--worker")
    server.start()
    server.wait_until_ready()
    server.wait_for_two()
    wait_for_log(server, "worker_started")
    assert server.log.count("worker_started") == 1
    children = server.pids()
    under_way = [connection for owned in server.half_requests().values() for connection in owned]
    server.process.send_signal(signal.SIGTERM)

    def nobody_listens():
        with contextlib.suppress(ConnectionResetError):  # closed while it was being made: some process may still listen
            try:
                server.connect().close()
            except ConnectionRefusedError:
                return True

    wait_until(nobody_listens, "the processes to listen no more")
    for connection in under_way:
        connection.sendall(BODY[10:])
    assert all(status_of(connection) in (401, 404, 422) for connection in under_way)
    for connection in under_way:
        connection.close()
    assert server.process.wait(PATIENCE_SECONDS) == 0
    assert not list(server.scratch.iterdir())
    assert not any(pathlib.Path(f"/proc/{pid}").exists() for pid in children)
    assert "worker_stopped" in server.log


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"TADA_TRUSTED_PROXIES": "nonsense"}, "TADA_TRUSTED_PROXIES: 'nonsense' is neither an address nor a network"),
        ({"TADA_DATABASE_URL": "sqlite:////proc/none/tada.sqlite3"}, "tada: "),
    ],
)
def test_wrong_setting_is_explained_once(tmp_path, sqlite_template, variables, message):
    server = TwoProcesses(tmp_path, sqlite_template, **variables)
    server.start()
    assert server.process.wait(PATIENCE_SECONDS) == 2
    assert server.log.count("tada: ") == 1
    assert message in server.log
    assert not list(server.scratch.iterdir())
    assert "Traceback" not in server.log


def test_sigterm_to_one_process_stops_its_worker_in_order(tmp_path, sqlite_template):
    server = Server(tmp_path, TADA_LOG_LEVEL="INFO")
    server.data_dir.mkdir()
    shutil.copyfile(sqlite_template, server.data_dir / "tada.sqlite3")
    server.start()
    server.wait_until_ready()
    wait_for_log(server, "worker_started")
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(PATIENCE_SECONDS) == 0
    assert "worker_stopped" in server.log


def test_port_in_use_is_explained_once(tmp_path, sqlite_template):
    server = TwoProcesses(tmp_path, sqlite_template)
    with socket.create_server(("127.0.0.1", server.port)):
        server.start()
        assert server.process.wait(PATIENCE_SECONDS) == 2
    assert server.log.count("tada: ") == 1
    assert f"port {server.port}: Address already in use" in server.log
