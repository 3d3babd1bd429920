"""A deployment of real processes: SQLite and files with one server, or PostgreSQL with two servers and two workers.

Each server, the database and the store are reached through proxies that can be told to misbehave; the checker goes
around them.
"""

import contextlib
import os
import signal
import time
from collections import Counter
from unittest import mock

import psycopg

from app.core.settings import Settings
from app.meals.estimate.job_runner import TRIES_ALONE
from tests.e2e.faults.child_at_work import estimate_of
from tests.e2e.faults.disk import Disk
from tests.e2e.faults.programs import Clock, Postgres, ServiceManager, Store, Tada, child_named, children_of, send
from tests.e2e.faults.proxy import Network
from tests.e2e.processes import environment_of, free_port, new_phone
from tests.support.commands import run_tada
from tests.support.s3_server import S3Server
from tests.support.waiting import wait_until

BUCKET = "faults"
FILES_MEBIBYTES = 192
DATABASE_MEBIBYTES = 288
STUDY = "faults"
RETENTION_DAYS = 365  # a clock that jumps by more must erase nothing
SECONDS_FOR_A_JOB = 3.0  # that a worker's death waits for a job that it can hit
MOST_KILLS = TRIES_ALONE  # of one estimate's children: the try after them is the last


class Deployment:
    """database: sqlite or postgres. store: files or s3."""

    def __init__(self, folder, database, store):
        self.folder = folder
        self.is_embedded = database == "sqlite"
        self.has_s3 = store == "s3"
        self.apis, self.workers, self.links = [], [], {}
        self.children_killed = Counter()  # by the name of the estimate that each was at
        self.database = self.store = None
        self._cleanup = contextlib.ExitStack()
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def _start(self):
        folder = self.folder
        switches = folder / "switches"
        switches.mkdir(parents=True)
        self.switches = switches
        self.clocks = {name: Clock(folder / f"clock-{name}") for name in ("api", "worker", "database")}
        self.disks = {"files": Disk(folder / "disk", switches, FILES_MEBIBYTES)}
        self._cleanup.callback(self.disks["files"].close)
        if not self.is_embedded:
            self.disks["database"] = Disk(folder / "database", switches, DATABASE_MEBIBYTES)
            self._cleanup.callback(self.disks["database"].close)
        self.manager = ServiceManager()
        self._cleanup.callback(self.manager.close)
        network = Network()
        self._cleanup.callback(network.close)
        self.data_dir = folder / "disk" / "data"
        self.variables = {"TADA_MIN_FREE_BYTES": "0", "TADA_LOG_LEVEL": "WARNING"}
        self.direct = dict(self.variables)  # what the checker uses
        if not self.is_embedded:
            self._start_database(network)
        if self.has_s3:
            self._start_store(network)
        self.tada("db", "upgrade")
        for number in range(1 if self.is_embedded else 2):
            port = free_port()
            command = ["serve"] if self.is_embedded else ["serve", "--no-worker"]
            environment = self._environment("api", TADA_PORT=str(port))
            self.apis.append(Tada(f"api{number}", folder, command, environment, switches, port))
            self.links[f"phone-{number}"] = network.link(f"phone-{number}", port)
        if not self.is_embedded:
            self.workers += [self.new_worker(f"worker{number}") for number in range(2)]
        for program in [*self.apis, *self.workers]:
            self.manager.keep(program)
        for api in self.apis:
            api.wait_until_ready()

    def new_worker(self, name, **variables):
        return Tada(name, self.folder, ["worker"], self._environment("worker", **variables), self.switches)

    def worker_pid(self, rng, witness):
        """A worker that runs, one with a job if there is any soon: (pid, program or None for the server's own)."""
        chosen = rng.choice(self.workers) if self.workers else None
        deadline = time.monotonic() + SECONDS_FOR_A_JOB
        while time.monotonic() < deadline:
            for pid, program in self._running_workers():
                if witness.has_job(pid):
                    return pid, program
            time.sleep(0.05)
        running = {program: pid for pid, program in self._running_workers()}
        return running.get(chosen), chosen

    def stop_child(self, rng, *, to_kill):
        """SIGSTOP to a child that estimates just now, one that may still be killed if that is to follow.

        Returns its process id and the estimate's name; None if no child was at work in time. What it is at is read
        again once it is stopped: it may have gone on to another estimate meanwhile.
        """
        deadline = time.monotonic() + SECONDS_FOR_A_JOB
        while time.monotonic() < deadline:
            pids = [child for pid, _ in self._running_workers() for child in children_of(pid)]
            rng.shuffle(pids)
            for pid in pids:
                if estimate_of(pid) is None:
                    continue
                send(pid, signal.SIGSTOP)
                estimate = estimate_of(pid)
                if estimate is not None and not (to_kill and self.children_killed[estimate] >= MOST_KILLS):
                    return pid, estimate
                send(pid, signal.SIGCONT)
            time.sleep(0.02)
        return None

    def _running_workers(self):
        """(pid, program) of those that run; the server's own has no program."""
        if self.is_embedded:
            server = self.apis[0].pid
            pid = child_named(server, "worker") if server is not None else None
            return [(pid, None)] if pid is not None else []
        return [(worker.pid, worker) for worker in self.workers if worker.pid is not None]

    @property
    def addresses(self):
        """Where phones reach the servers."""
        return [f"http://127.0.0.1:{link.port}" for name, link in self.links.items() if name.startswith("phone")]

    def heal(self):
        for link in self.links.values():
            link.heal()
        for disk in self.disks.values():
            disk.free()
        for clock in self.clocks.values():
            clock.jump(0)
        (self.switches / "slow").unlink(missing_ok=True)

    def tada(self, *arguments):
        """Another `tada` command on the same data, in this process and past the proxies: its standard output."""
        done = run_tada(*arguments, **self.direct_variables)
        assert done.returncode == 0, f"tada {' '.join(arguments)}:\n{done.stdout}\n{done.stderr}"
        return done.stdout.strip()

    @property
    def settings(self):
        """The deployment's settings, past the proxies."""
        with mock.patch.dict(os.environ, self.direct_variables, clear=True):
            return Settings()

    @property
    def direct_variables(self):
        own = environment_of(self.data_dir, **self.direct)
        return {name: value for name, value in own.items() if name.startswith("TADA_")}

    def enrol(self, codes):
        """Participants with a phone each, by code: the phone's token."""
        admin_token = self.tada("admin", "create", "admin")
        address = f"http://127.0.0.1:{self.apis[0].port}"
        return {code: new_phone(address, admin_token, code, STUDY, retention_days=RETENTION_DAYS) for code in codes}

    def logs(self):
        """Program's name -> its log."""
        names = {path.stem: path for path in self.folder.glob("*.log") if path.stem not in ("postgres", "store")}
        return {name: path.read_text(errors="replace") for name, path in sorted(names.items())}

    def close(self):
        with contextlib.suppress(OSError, AttributeError):
            self.heal()
        self._cleanup.close()

    def _start_database(self, network):
        self.database = Postgres(self.folder, self.folder / "database" / "pg", self.clocks["database"])
        self.manager.keep(self.database)
        self.direct["TADA_DATABASE_URL"] = self.database.url
        for who in ("api", "worker"):
            self.links[f"database-{who}"] = network.link(f"database-{who}", self.database.port)
        wait_for_database(self.database.url)

    def _start_store(self, network):
        def first():
            server = S3Server.start(self.folder / "disk" / "s3")
            server.make_bucket(BUCKET)
            return server

        server = self.manager.starter.submit(first).result(90)
        self.store = Store(self.folder, server)
        self.manager.keep(self.store)
        for who in ("api", "worker"):
            self.links[f"store-{who}"] = network.link(f"store-{who}", server.port)
        s3 = {
            "TADA_BLOB_URL": f"s3://{BUCKET}/blobs",
            "TADA_S3_ENDPOINT": server.endpoint,
            "TADA_S3_ACCESS_KEY_ID": server.access_key_id,
            "TADA_S3_SECRET_ACCESS_KEY": server.secret_access_key,
        }
        self.direct |= s3

    def _environment(self, who, **variables):
        settings = self.direct | variables
        if self.database is not None:
            settings["TADA_DATABASE_URL"] = self.database.url.replace(
                f":{self.database.port}/", f":{self.links[f'database-{who}'].port}/"
            )
        if self.store is not None:
            settings["TADA_S3_ENDPOINT"] = f"http://127.0.0.1:{self.links[f'store-{who}'].port}"
        return environment_of(self.data_dir, **settings) | self.clocks[who].environment


def wait_for_database(url):
    def is_there():
        with contextlib.suppress(psycopg.OperationalError):
            psycopg.connect(url, connect_timeout=5).close()
            return True

    wait_until(is_there, "the database", interval_seconds=0.1)
