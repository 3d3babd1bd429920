"""Real processes of the real program, started, killed and started again by a test."""

import contextlib
import functools
import os
import pathlib
import signal
import socket
import subprocess
import sys
import tempfile

import httpx2

import app.tables  # noqa: F401  # defines every table
from app.core.settings import Settings
from app.db.session import Database
from app.operations.prepare import prepare
from app.people.access.staff import create_admin
from tests.conftest import make_template
from tests.support.waiting import PATIENCE_SECONDS, wait_until

START_SECONDS = 300.0  # of a server that migrates an empty database on a loaded machine
REPOSITORY = pathlib.Path(__file__).parents[2]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def environment_of(data_dir, **variables):
    """The environment of a process of ours: nothing of the caller's TADA_* variables, our own on top."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("TADA_")}
    return (
        environment
        | {"TADA_DATA_DIR": str(data_dir), "TADA_LOG_LEVEL": "WARNING", "TADA_SECRET_KEY": "k" * 40}
        | variables
    )


@functools.cache
def prepared_sqlite():
    """Return the database file that the first start of `tada serve` makes."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "tada.sqlite3"
        make_template(f"sqlite:///{path}", lambda new: prepare(new, Settings(data_dir=pathlib.Path(folder))))
        return path.read_bytes()


class Program:
    """One long-running command; its output goes to a file of the test's folder."""

    def __init__(self, command, environment, log_path, folder=REPOSITORY):
        self._folder = folder  # of the program: another version's, maybe
        self._command = command
        self._environment = environment
        self._log_path = log_path
        self.process = None

    def start(self):
        with self._log_path.open("ab") as log:
            self.process = subprocess.Popen(
                self._command, env=self._environment, stdout=log, stderr=log, cwd=self._folder, start_new_session=True
            )

    def kill(self):
        """SIGKILL, as a crash or a power cut would."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self):
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.kill()

    @property
    def log(self):
        return self._log_path.read_text(errors="replace")


class Server(Program):
    """`tada serve` on a port that stays the same over restarts."""

    program = "app.cli"

    def __init__(self, folder, *arguments, **variables):
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self.data_dir = folder / "data"
        self.environment = environment_of(self.data_dir, TADA_PORT=str(self.port), **variables)
        command = [sys.executable, "-m", self.program, "serve", *arguments]
        super().__init__(command, self.environment, folder / "server.log")

    @property
    def database_url(self):
        return f"sqlite:///{self.data_dir / 'tada.sqlite3'}"

    def place_prepared_database(self):
        """Let the first start find what it would make: for tests of anything that comes later."""
        self.data_dir.mkdir(parents=True)
        (self.data_dir / "tada.sqlite3").write_bytes(prepared_sqlite())

    def create_admin(self, name):
        """Return the token of a new admin, as `tada admin create` does, which takes seconds to start."""
        database = Database(self.database_url)
        try:
            return create_admin(database, name)
        finally:
            database.dispose()

    def wait_until_ready(self):
        def is_ready():
            assert self.process.poll() is None, f"the server ended with {self.process.returncode}:\n{self.log}"
            with contextlib.suppress(httpx2.TransportError):
                return client.get("/readyz").status_code == 200

        def words():
            return f"the server to be ready:\n{self.log}"

        with httpx2.Client(base_url=self.address, timeout=5) as client:
            wait_until(is_ready, words, interval_seconds=0.1, patience_seconds=START_SECONDS)

    def tada(self, *arguments):
        """Run another `tada` command on the same data: its standard output."""
        done = subprocess.run(
            [sys.executable, "-m", "app.cli", *arguments],
            env=self.environment,
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()


class RecallingServer(Server):
    """A server whose worker computes the same photographs once (recalling.py)."""

    program = "tests.e2e.recalling"

    def __init__(self, folder, *arguments, **variables):
        super().__init__(folder, *arguments, TMPDIR=str(folder), **variables)


def enrolment_code(server, participant="P001", study="pilot", **protocol):
    """A one-time code of a new participant; the study is made if there is none yet, by `protocol`."""
    admin = {"Authorization": f"Bearer {server.create_admin(f'admin of {study} {participant}')}"}
    with httpx2.Client(base_url=server.address, headers=admin, timeout=PATIENCE_SECONDS) as client:
        return new_code(client, participant, study, **protocol)


def new_code(admin, participant="P001", study="pilot", **protocol):
    """The same by an admin's HTTP client."""
    admin.post("/v1/studies", json={"code": study, "name": study, "marker": "plain:9x7:11", **protocol})
    admin.post(f"/v1/studies/{study}/participants", json={"code": participant})
    return admin.post(f"/v1/studies/{study}/participants/{participant}/enrolment-codes").json()["code"]


def new_phone(address, admin_token, participant="P001", study="pilot", device_name="phone", **protocol):
    """The token of a phone of a new participant."""
    admin = {"Authorization": f"Bearer {admin_token}"}
    with httpx2.Client(base_url=address, headers=admin, timeout=PATIENCE_SECONDS) as client:
        enrolment = {"code": new_code(client, participant, study, **protocol), "device_name": device_name}
        return client.post("/v1/enrolments", json=enrolment).json()["token"]


def enrolled_client(server, participant="P001", study="pilot", **protocol):
    """A phone's HTTP client, enrolled over HTTP."""
    admin_token = server.create_admin(f"admin of {study} {participant}")
    token = new_phone(server.address, admin_token, participant, study, **protocol)
    headers = {"Authorization": f"Bearer {token}"}
    return httpx2.Client(base_url=server.address, headers=headers, timeout=PATIENCE_SECONDS)
