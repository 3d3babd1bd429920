"""A sandbox on a real server: docs/sandbox.md word for word, and the answers that need a connection or a worker."""

import json
import subprocess
import sys
import time
import uuid

import httpx2
import pytest

from tests.e2e.documents import BLOCK, run_blocks
from tests.e2e.processes import REPOSITORY, RecallingServer, enrolled_client, enrolment_code

pytestmark = pytest.mark.slow

DEMO = REPOSITORY / "app" / "demo_data"
METADATA = {"captured_at": "2026-11-20T12:30:00+08:00", "time_zone": "Asia/Shanghai"}
PATIENCE_SECONDS = 120


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    server = RecallingServer(tmp_path_factory.mktemp("sandbox"))
    server.place_prepared_database()
    server.start()
    server.wait_until_ready()
    yield server
    server.stop()


@pytest.fixture(scope="module")
def phone(served):
    with enrolled_client(served, study="try", sandbox=True) as phone:
        yield phone


def send_whole(phone, asked=None, **fields):
    metadata = METADATA | {"id": str(uuid.uuid4())} | fields
    files = {"metadata": ("m.json", json.dumps(metadata), "application/json")}
    files |= {side: (f"{side}.jpg", (DEMO / f"{side}.jpg").read_bytes()) for side in ("left", "right")}
    return phone.post("/v1/meals", files=files, headers={"Tada-Sandbox": asked} if asked else {})


def test_every_line_of_the_sandbox_document_works_as_printed(served, tmp_path):
    blocks = BLOCK.findall((REPOSITORY / "docs" / "sandbox.md").read_text())
    done = run_blocks(served, tmp_path, blocks)
    assert done.returncode == 0, done.stderr + done.stdout + served.log
    for expected in ("retry-after: 3", '"code":"unavailable"', "again: 200", '"code":"rate_limited"', "marker_cut_off"):
        assert expected in done.stdout


def test_study_of_participants_is_refused(served):
    code = enrolment_code(served, "P002", "pilot")
    environment = served.environment | {"TADA_TOKEN": served.create_admin("somebody")}
    command = [sys.executable, "-m", "app.cli", "sandbox", "--server", served.address, "--study", "pilot"]
    done = subprocess.run(command, env=environment, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert (done.returncode, "is no sandbox" in done.stderr) == (2, True), done.stdout + done.stderr
    command = [sys.executable, "-m", "app.cli", "conformance", "run", served.address, "--code", code]
    done = subprocess.run(command, env=environment, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert (done.returncode, "is no sandbox" in done.stderr) == (2, True), done.stdout + done.stderr
    assert "code is spent" in " ".join(done.stderr.split())
    staff = {"Authorization": f"Bearer {environment['TADA_TOKEN']}"}
    answer = httpx2.get(f"{served.address}/v1/studies/pilot/devices", headers=staff, timeout=PATIENCE_SECONDS)
    (device,) = [device for device in answer.json()["items"] if device["participant"] == "P002"]
    assert device["revoked_at"] is not None


def test_conformance_run_passes_our_server_and_writes_its_report(served, tmp_path):
    code = enrolment_code(served, "P003", "try", sandbox=True)
    command = [sys.executable, "-m", "app.cli", "conformance", "run", served.address, "--code", code, "-o", tmp_path]
    done = subprocess.run(
        command, env=served.environment, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (report,) = json.loads((tmp_path / "report.json").read_text())
    assert report["conforming"] is True
    assert {check["outcome"] for check in report["checks"]} == {"passed"}
    assert "all required checks have passed" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("most", [0, 1000])
def test_lost_request_keeps_nothing(phone, most):
    path = f"/v1/meals/{uuid.uuid4()}"
    assert phone.put(path, json=METADATA).status_code == 202
    headers, left = {"Tada-Sandbox": f"lose_request={most}"}, (DEMO / "left.jpg").read_bytes()
    with pytest.raises(httpx2.TransportError):
        phone.put(f"{path}/images/left", content=left, headers=headers)
    assert phone.get(path).json()["missing"] == ["left", "right"]


def test_lost_answer_leaves_the_request_carried_out_and_a_shorter_one_arrives(phone):
    path, headers = f"/v1/meals/{uuid.uuid4()}", {"Tada-Sandbox": "lose_answer=100"}
    with pytest.raises(httpx2.TransportError):
        phone.put(path, json=METADATA, headers=headers)
    assert phone.put(path, json=METADATA).status_code == 200
    assert phone.get("/v1/me", headers={"Tada-Sandbox": "lose_answer=100000"}).json()["participant"] == "P001"


@pytest.mark.parametrize("asked", ["lose_request=10", "lose_answer=0"])
def test_metadata_lose_the_first_request_or_answer(phone, asked):
    meal = str(uuid.uuid4())
    with pytest.raises(httpx2.TransportError):
        send_whole(phone, id=meal, sandbox=asked)
    again = send_whole(phone, id=meal, sandbox=asked)
    assert again.status_code == (200 if asked == "lose_answer=0" else 202)


def test_slow_answer_is_late(phone):
    began = time.monotonic()
    phone.get("/v1/me", headers={"Tada-Sandbox": "wait=2"})
    assert time.monotonic() - began >= 2


def test_meal_is_measured_and_needs_a_review(phone):
    hints = [{"point": [1092, 620], "food": "apple"}]  # would otherwise say what it is
    meal = send_whole(phone, "meal=needs_review", hints=hints).json()
    deadline = time.monotonic() + PATIENCE_SECONDS
    while meal["status"] in {"queued", "processing"} and time.monotonic() < deadline:
        meal = phone.get(f"/v1/meals/{meal['id']}", params={"wait": 25}).json()
    assert meal["status"] == "needs_review"
    assert meal["items"][0]["volume_ml"] > 100
    assert (meal["items"][0]["food"], meal["items"][0]["candidates"]) == (None, [])
