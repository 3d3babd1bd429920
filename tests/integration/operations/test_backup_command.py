"""`tada backup` and `tada restore` as a person types them."""

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import tarfile
from datetime import UTC, date, datetime

import pyarrow.parquet as pq
import pytest

from app.operations.backup import write_backup
from app.operations.queries import last_backup
from app.people.privacy_models import Tombstone
from tests.integration.operations.deployments import SECRET, deployment
from tests.integration.operations.test_backup_refused import add_meal
from tests.support.commands import run_tada
from tests.support.waiting import PATIENCE_SECONDS, wait_until


@pytest.fixture
def place(database, tmp_path):
    """Environment of a deployment with one meal."""
    with deployment(tmp_path / "old", database.url) as here:
        add_meal(here)
    return variables(tmp_path / "old", database.url)


def variables(folder, url, **more):
    return {"TADA_DATA_DIR": folder, "TADA_DATABASE_URL": url, "TADA_SECRET_KEY": SECRET, **more}


def test_backup_is_for_its_owner_only_and_says_what_it_lacks(place, database, tmp_path):
    file = tmp_path / "one.tar"
    ended = run_tada("backup", file, **place)
    assert (ended.returncode, ended.stdout) == (0, "")
    assert "2 blobs" in ended.stderr
    assert "TADA_SECRET_KEY is not in it" in ended.stderr
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert SECRET.encode() not in file.read_bytes()
    assert [path.name for path in tmp_path.glob("*.tar*")] == ["one.tar"]
    with database.read() as session:
        assert not last_backup(session).piped


def test_backup_that_cannot_be_written_and_restore_from_a_pipe_are_told_in_words(place, tmp_path):
    file = tmp_path / "one.tar"
    file.write_bytes(b"the only good one")
    for command, words in (
        (("backup", file), "overwrites nothing"),
        (("backup", tmp_path / "nowhere" / "one.tar"), "nowhere"),
        (("restore", "-"), "must be a file"),  # it is read twice
    ):
        ended = run_tada(*command, **place)
        assert (ended.returncode, words in ended.stderr) == (2, True), ended.stderr
    assert file.read_bytes() == b"the only good one"


@pytest.mark.both_stores
def test_backup_of_a_database_without_tables_is_refused(tmp_path, database_url):
    ended = run_tada("backup", tmp_path / "one.tar", **variables(tmp_path / "new", database_url))
    assert ended.returncode == 2
    assert "nothing to back up" in ended.stderr


@pytest.mark.slow
def test_backup_that_is_told_to_end_leaves_no_half_of_itself(place, tmp_path):
    """A scheduler's time limit or a lost terminal: the half would hold people's data, under a name that nobody sees."""
    blob = next(path for path in (tmp_path / "old" / "blobs").rglob("left/*") if path.is_file())
    blob.unlink()
    os.mkfifo(blob)  # reading it waits for us
    folder = tmp_path / "backups"
    folder.mkdir()
    environment = {name: str(value) for name, value in place.items()} | {"PATH": "/usr/bin:/bin"}
    command = [sys.executable, "-m", "app.cli", "backup", str(folder / "one.tar")]
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as process:
        try:
            pipe = opened_once_it_is_read(blob)
            assert [path.suffix for path in folder.iterdir()] == [".partial"]
            process.send_signal(signal.SIGTERM)
            os.close(pipe)
            assert process.wait(PATIENCE_SECONDS) == 128 + signal.SIGTERM
        finally:
            process.kill()
    assert list(folder.iterdir()) == []


def opened_once_it_is_read(pipe):
    """A named pipe to write to, once another process reads from it."""

    def opened():
        try:
            return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise

    return wait_until(opened, "another process to read from the pipe")


def test_damaged_blob_is_told_by_name_with_status_1(place, tmp_path):
    blob = next(path for path in (tmp_path / "old" / "blobs").rglob("left/*") if path.is_file())
    blob.write_bytes(b"other bytes")
    ended = run_tada("backup", tmp_path / "one.tar", "--json", **place)
    assert ended.returncode == 1
    told = json.loads(ended.stdout)
    assert told["damaged_blobs"] == 1
    assert list(told["damaged"]) == [blob.relative_to(tmp_path / "old" / "blobs").as_posix()]
    assert told["blobs"] == 1
    for option in ("--check", "--json"):
        machine = variables(tmp_path / "new", f"sqlite:///{tmp_path / 'new' / 'tada.sqlite3'}")
        restored = run_tada("restore", tmp_path / "one.tar", option, **place if option == "--check" else machine)
        assert restored.returncode == 1, restored.stderr  # a script that checks backups must hear of it


def test_second_backup_to_a_name_that_was_taken_meanwhile_leaves_the_first(place, tmp_path, monkeypatch):
    """Two schedulers, or one that is too early: to look whether the name is free, and then to rename, is too late."""
    file = tmp_path / "one.tar"
    file.write_bytes(b"the first one")
    with monkeypatch.context() as patch:
        patch.setattr(write_backup.Path, "exists", lambda _path: False)  # they looked before
        ended = run_tada("backup", file, **place)
    assert (ended.returncode, "overwrites nothing" in ended.stderr) == (2, True)
    assert file.read_bytes() == b"the first one"
    assert [path.name for path in tmp_path.iterdir() if "one.tar" in path.name] == ["one.tar"]


def test_restore_with_another_ledger_is_refused_until_told_to_go_on(place, database, tmp_path):
    with database.write() as session:
        session.add(Tombstone(kind="meal", digest="a" * 64, study_id=None, erased_at=datetime.now(UTC)))
    assert run_tada("backup", tmp_path / "one.tar", **place).returncode == 0
    machine = variables(tmp_path / "new", f"sqlite:///{tmp_path / 'new' / 'tada.sqlite3'}")
    refused = run_tada("restore", tmp_path / "one.tar", **machine)
    assert refused.returncode == 2
    assert "lacks 1 erasures" in refused.stderr
    assert "--other-ledger" in refused.stderr
    restored = run_tada("restore", "--other-ledger", tmp_path / "one.tar", **machine)
    assert restored.returncode == 0, restored.stderr
    assert "it lacks 1 erasures that the backup records" in restored.stderr


def test_restore_tells_what_came_and_refuses_a_second_time(place, tmp_path):
    backed_up = json.loads(run_tada("backup", tmp_path / "one.tar", "--json", **place).stdout)
    checked = run_tada("restore", tmp_path / "one.tar", "--check", "--json", **place)
    assert json.loads(checked.stdout) == backed_up
    machine = variables(tmp_path / "new", f"sqlite:///{tmp_path / 'new' / 'tada.sqlite3'}")
    restored = run_tada("restore", tmp_path / "one.tar", "--json", **machine)
    assert restored.returncode == 0
    assert json.loads(restored.stdout) == backed_up | {"queued_again": 0, "missing_in_ledger": 0}
    again = run_tada("restore", tmp_path / "one.tar", **machine)
    assert again.returncode == 2
    assert "has data already" in again.stderr


@pytest.mark.slow
def test_backup_through_a_pipe_is_a_tar_like_any_other_and_noted_as_piped(place, database, tmp_path):
    """As a process of its own: a test's standard output has no bytes beneath it. The format is what others unpack."""
    environment = {name: str(value) for name, value in place.items()} | {"PATH": "/usr/bin:/bin"}
    made = subprocess.run(
        [sys.executable, "-m", "app.cli", "backup", "-", "--json"], env=environment, capture_output=True, check=True
    )
    told = json.loads(made.stderr.splitlines()[-1])
    (tmp_path / "piped.tar").write_bytes(made.stdout)
    with tarfile.open(tmp_path / "piped.tar") as tar:
        tar.extractall(tmp_path / "unpacked", filter="data")
    meals = pq.read_table(tmp_path / "unpacked" / "tables" / "meal").to_pylist()
    assert [meal["local_date"] for meal in meals] == [date(2026, 11, 20)]
    assert len(list((tmp_path / "unpacked" / "blobs").rglob("*/left/*"))) == 1
    assert told["blobs"] == 2
    assert run_tada("restore", tmp_path / "piped.tar", "--check", **place).returncode == 0
    with database.read() as session:
        assert last_backup(session).piped
