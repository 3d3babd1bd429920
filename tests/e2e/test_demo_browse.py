"""`tada demo --browse` as somebody runs it: an address and accounts that open it, and nothing left behind."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading

import httpx2
import pytest

from tests.support.waiting import PATIENCE_SECONDS

START_SECONDS = 180


@pytest.mark.slow
def test_sample_study_is_served_until_interrupted_and_its_folder_goes(tmp_path):
    with demo(tmp_path) as process:
        printed = read_until(process, "show the progress")
        address = re.search(r"(http://\S+?)/dashboard/studies/sample", printed)
        assert address, printed
        accounts = dict(re.findall(r"(?:owner|reviewer|viewer|admin) +(\w+) +password (\S+)", printed))
        assert set(accounts) == {"olga", "rene", "vera", "ada"}, printed
        for name, password in accounts.items():
            with httpx2.Client(base_url=address[1], timeout=PATIENCE_SECONDS) as client:
                answer = client.post("/v1/sessions", json={"name": name, "password": password})
                assert answer.status_code == 201
                token = {"Authorization": f"Bearer {answer.json()['token']}"}
                meals = client.get("/v1/meals", params={"study": "sample"}, headers=token).json()["items"]
            assert "receiving" in {meal["status"] for meal in meals}
        assert list(tmp_path.glob("tada-demo-*"))
        os.killpg(process.pid, signal.SIGINT)
        require_done(process, tmp_path)


@pytest.mark.slow
def test_demo_that_is_asked_to_end_while_it_starts_leaves_no_folder(tmp_path):
    with demo(tmp_path) as process:
        read_until(process, "A throwaway server")
        process.send_signal(signal.SIGTERM)
        require_done(process, tmp_path)


@contextlib.contextmanager
def demo(folder):
    """The command, whose temporary files lie in this folder."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("TADA_")}
    process = subprocess.Popen(
        [sys.executable, "-m", "app.cli", "demo", "--browse", "--seed", "7"],
        env=environment | {"TMPDIR": str(folder), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    too_long = threading.Timer(START_SECONDS, os.killpg, (process.pid, signal.SIGKILL))  # the server holds the pipe too
    too_long.start()
    try:
        yield process
    finally:
        too_long.cancel()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        process.stdout.close()


def read_until(process, words):
    """What the command prints up to a line with these words."""
    printed = ""
    for line in process.stdout:
        printed += line
        if words in line:
            break
    return printed


def require_done(process, folder):
    rest, _ = process.communicate()
    assert (process.returncode, "Done" in rest) == (0, True), rest
    assert not list(folder.glob("tada-demo-*"))
