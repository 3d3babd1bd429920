"""`tada demo --browse` as somebody runs it: an address and accounts that open it, and nothing left behind."""

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
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_sample_study_is_served_until_interrupted_and_its_folder_goes(tmp_path, ending):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("TADA_")}
    process = subprocess.Popen(
        [sys.executable, "-m", "app.cli", "demo", "--browse", "--seed", "7"],
        env=environment | {"TMPDIR": str(tmp_path), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    too_long = threading.Timer(START_SECONDS, os.killpg, (process.pid, signal.SIGKILL))  # the server holds the pipe too
    too_long.start()
    try:
        printed = ""
        for line in process.stdout:
            printed += line
            if "show the progress" in line:
                break
        address = re.search(r"(http://\S+?)/dashboard/studies/sample", printed)
        assert address, printed
        accounts = dict(re.findall(r"(?:owner|reviewer|viewer|admin) +(\w+) +password (\S+)", printed))
        assert set(accounts) == {"olga", "rene", "vera", "ada"}, printed
        for name, password in accounts.items():
            answer = httpx2.post(
                f"{address[1]}/v1/sessions", json={"name": name, "password": password}, timeout=PATIENCE_SECONDS
            )
            assert answer.status_code == 201
            token = {"Authorization": f"Bearer {answer.json()['token']}"}
            meals = httpx2.get(
                f"{address[1]}/v1/meals", params={"study": "sample"}, headers=token, timeout=PATIENCE_SECONDS
            ).json()["items"]
            assert "receiving" in {meal["status"] for meal in meals}
        assert list(tmp_path.glob("tada-demo-*"))
        os.killpg(process.pid, ending) if ending == signal.SIGINT else process.send_signal(ending)
        rest, _ = process.communicate()
        assert (process.returncode, "Done" in rest) == (0, True), printed + rest
        assert not list(tmp_path.glob("tada-demo-*"))
    finally:
        too_long.cancel()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        process.stdout.close()
