"""The program of an earlier commit beside today's, on one PostgreSQL: meals sent to either are estimated by either."""

import contextlib
import csv
import io
import shutil
import subprocess
import sys
import tarfile
import time
import uuid

import httpx2
import pytest

from tests.conftest import postgres_database
from tests.e2e.processes import REPOSITORY, Program, environment_of, free_port, new_phone
from tests.e2e.test_compose import answers, estimated, send, wait_for
from tests.support.next_migration import REVISION, write_next_migration

OLD = "32aeb70"  # the first commit with this schema
SECONDS = 120


@pytest.fixture
def old_program(tmp_path):
    """Its folder."""
    archive = tmp_path / "old.tar"
    done = subprocess.run(
        ["git", "archive", "--output", archive, OLD, "app", "migrations", "docs"],
        cwd=REPOSITORY,
        capture_output=True,
        check=False,
    )
    if done.returncode:  # no skip, which CI would count as a test that it lacks the means for
        pytest.xfail(f"needs the commit {OLD}, and this is no clone with its history")
    with tarfile.open(archive) as files:
        files.extractall(tmp_path / "old", filter="data")
    return tmp_path / "old"


@pytest.fixture
def new_program(tmp_path):
    """The folder of ours, with one more migration."""
    folder = tmp_path / "new"
    for part in ("app", "migrations", "docs"):
        shutil.copytree(REPOSITORY / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    write_next_migration(folder / "migrations")
    return folder


class Version:
    """API, worker and commands of one version."""

    def __init__(self, folder, program, url, stack):
        self._folder, self._program, self._stack = folder, program, stack
        folder.mkdir(exist_ok=True)
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self.environment = environment_of(
            folder / "data",
            TADA_DATABASE_URL=url,
            TADA_BLOB_URL=f"file://{folder.parent / 'blobs'}",
            TADA_ERASURE_URL=f"file://{folder.parent / 'erasures'}",
            TADA_PORT=str(self.port),
            PYTHONPATH=str(program),
        )

    def start(self, *arguments):
        log_path = self._folder / f"{arguments[0]}.log"
        program = Program([*self._command(), *arguments], self.environment, log_path, folder=self._program)
        self._stack.callback(program.stop)
        program.start()
        return program

    def tada(self, *arguments):
        done = subprocess.run(
            [*self._command(), *arguments],
            env=self.environment,
            cwd=self._program,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def _command(self):
        return [sys.executable, "-m", "app.cli"]


@pytest.mark.slow
def test_old_and_new_processes_share_meals_while_machines_are_upgraded_one_by_one(
    postgres_server, old_program, new_program, tmp_path
):
    with contextlib.ExitStack() as stack:
        url = stack.enter_context(postgres_database(postgres_server))
        old = Version(tmp_path / "before", old_program, url, stack)
        new = Version(tmp_path / "after", new_program, url, stack)
        old_api, old_worker = old.start("serve", "--no-worker"), old.start("worker")
        wait_for(lambda: answers(f"{old.address}/readyz"), old_api, old_worker)
        token = new_phone(old.address, old.tada("admin", "create", "chief"))
        phones = [
            stack.enter_context(
                httpx2.Client(base_url=version.address, headers={"Authorization": f"Bearer {token}"}, timeout=30)
            )
            for version in (old, new)
        ]
        deadline = time.monotonic() + SECONDS
        meals = [str(uuid.uuid4()) for _ in range(2)]

        new.tada("db", "upgrade")
        assert REVISION in new.tada("db", "current")
        new_api = new.start("serve", "--no-worker")
        wait_for(lambda: answers(f"{new.address}/readyz"), new_api)
        send(phones[1], meals[0])  # to the new API, when only the old worker is there
        assert estimated(phones[0], meals[0], deadline)["status"] == "estimated", old_worker.log

        new_worker = new.start("worker")
        old_worker.stop()
        send(phones[0], meals[1])  # to the old API, for the new worker
        assert estimated(phones[1], meals[1], deadline)["status"] == "estimated", new_worker.log
        assert old_worker.process.returncode == 0

        for phone in phones:
            records = list(csv.DictReader(io.StringIO(phone.get("/v1/records", params={"format": "csv"}).text)))
            assert sorted(record["meal_id"] for record in records) == sorted(meals)
        old_api.stop()
        assert "0 differ" in new.tada("records", "rebuild", "--check")
        logs = [program.log for program in (old_api, old_worker, new_api, new_worker)]
        assert [line for log in logs for line in log.splitlines() if '"level": "error"' in line] == []
