"""The apps that we ship pass `tada conformance serve`: the capture page and both clients; a bad app fails."""

import contextlib
import json
import re
import shutil
import subprocess
import sys
import uuid

import httpx2
import pytest
from playwright.sync_api import expect
from tada_client import Phone, Problem

from tests.e2e.processes import REPOSITORY, START_SECONDS, Program, environment_of, free_port
from tests.support.waiting import PATIENCE_SECONDS, wait_until

pytestmark = pytest.mark.slow

DEMO = REPOSITORY / "app" / "demo_data"
PAIRS = [{side: DEMO / folder / f"{side}.jpg" for side in ("left", "right")} for folder in ("", "salad_pear")]
METADATA = {"captured_at": "2026-11-20T12:30:00+08:00", "time_zone": "Asia/Shanghai"}
PATIENCE_MS = 100_000


class ConformanceServer(Program):
    """`tada conformance serve`: its address, its enrolment code, and its verdicts."""

    def __init__(self, folder):
        port = free_port()
        self.address = f"http://127.0.0.1:{port}"
        command = [sys.executable, "-m", "tests.e2e.recalling", "conformance", "serve", "--port", str(port)]
        environment = environment_of(folder / "data", PYTHONUNBUFFERED="1", TMPDIR=str(folder))
        super().__init__(command, environment, folder / "server.log")
        self.start()
        wait_until(self._listens, lambda: self.log, patience_seconds=START_SECONDS)
        self.code = re.search(r"enrolment code +(\S+)", self.log)[1]

    def _listens(self):
        assert self.process.poll() is None, self.log
        return "listens on" in self.log

    def verdicts(self, name):
        """The checks of a phone by their outcome, and whether all is well."""
        report = httpx2.get(f"{self.address}/conformance.json", timeout=PATIENCE_SECONDS).json()
        phone = next(each for each in report if each["name"] == name)
        return {check["name"]: (check["outcome"], check["detail"]) for check in phone["checks"]}, phone["conforming"]

    def require_conforming(self, name):
        checks, is_conforming = self.verdicts(name)
        open_ones = {check: verdict for check, verdict in checks.items() if verdict[0] != "passed"}
        assert is_conforming, json.dumps(open_ones, indent=1)
        assert name in httpx2.get(f"{self.address}/conformance", timeout=PATIENCE_SECONDS).text


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    server = ConformanceServer(tmp_path_factory.mktemp("conformance"))
    yield server
    server.stop()
    assert server.process.returncode == 0, server.log


def test_python_client_passes(judge):
    with Phone(judge.address) as phone:
        phone.enrol({"code": judge.code, "device_name": "python client"})
        meals = [phone.send_meal(uuid.uuid4(), METADATA, photographs) for photographs in PAIRS]
        assert [meal["missing"] for meal in meals] == [[], []]
        meal = phone.wait_for_estimate(meals[0]["id"])
        item = meal["items"][0]
        event = {"kind": "set_food", "food": item["candidates"][0]["food"]["key"], "item": item["id"]}
        with pytest.raises(Problem, match="precondition_failed"):
            phone.send_event(meal, event)
        assert phone.send_event(phone.get_meal(meal["id"]), event)["version"] > meal["version"]
        phone.delete_meal(meals[1]["id"])
    judge.require_conforming("python client")


def test_python_client_passes_with_photographs_in_pieces(judge):
    padding = bytes(1_200_000)  # behind a JPEG's end
    with Phone(judge.address) as phone:
        phone.enrol({"code": judge.code, "device_name": "client in pieces"})
        for photographs in PAIRS:
            large = {slot: path.read_bytes() + padding for slot, path in photographs.items()}
            meal = phone.send_meal(uuid.uuid4(), METADATA, large)
            assert meal["missing"] == []
            phone.cancel_estimate(meal["id"])
    checks, _ = judge.verdicts("client in pieces")
    for name in ("safe_resending", "resume", "durable", "retry_after", "both_photographs"):
        assert checks[name][0] == "passed", checks[name]
    assert "pieces" in checks["durable"][1]


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_typescript_client_passes(judge):
    script = REPOSITORY / "tests" / "e2e" / "clients" / "typescript_conformance.mjs"
    done = subprocess.run(
        ["node", script, judge.address, judge.code, DEMO], capture_output=True, text=True, timeout=200, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    judge.require_conforming("typescript client")


def test_capture_page_passes(judge, open_page):
    tab = open_page(judge.address, viewport={"width": 390, "height": 844})
    tab.page.context.set_default_timeout(PATIENCE_MS)
    tab.expect("status of (412|429|503)|ERR_(CONNECTION|EMPTY|SOCKET)")
    page = tab.page
    page.goto(f"{judge.address}/capture/#code={judge.code}")
    expect(page.get_by_text("Sandbox: for trials only.")).to_be_visible(timeout=PATIENCE_MS)
    for photographs in PAIRS:
        page.get_by_role("button", name="Photograph a meal").click()
        for heading, side in (("First photograph", "left"), ("Second photograph", "right")):
            page.get_by_role("heading", name=heading).wait_for()
            with page.expect_file_chooser() as chooser:
                page.get_by_role("button", name="Choose a photograph").click()
            chooser.value.set_files(photographs[side])
        page.get_by_role("heading", name="Are both good?").wait_for()
        page.get_by_role("button", name="Send").click()
        page.get_by_role("button", name="Photograph a meal").wait_for()
    expect(page.locator("li[data-state=sent]")).to_have_count(2, timeout=PATIENCE_MS)
    # the newest first, by their EXIF
    apple, salad = [row.get_attribute("data-meal") for row in page.locator("li[data-state=sent]").all()]
    page.click(f"li[data-meal='{apple}'] a")
    # the food is assigned if earlier apps have taught it to the study, else it is chosen
    settle = page.locator("li[data-item] button.main, .choices button").first
    settle.click()
    page.get_by_text("The meal has changed meanwhile. This is ").wait_for()
    settle.click()
    page.wait_for_selector("li[data-status=confirmed], li[data-status=corrected]")
    page.once("dialog", lambda dialog: dialog.accept())
    page.goto(f"{judge.address}/capture/#meal/{salad}")
    page.get_by_role("button", name="Erase this meal").click()
    page.wait_for_selector(f"li[data-meal='{salad}']", state="detached")
    names = [each["name"] for each in httpx2.get(f"{judge.address}/conformance.json", timeout=PATIENCE_SECONDS).json()]
    judge.require_conforming(next(name for name in names if "client" not in name))


def test_app_that_drops_begins_anew_and_hurries_fails(judge):
    """One that sends each meal whole, under a new id each time, and does not wait."""
    enrolment = {"code": judge.code, "device_name": "a bad app"}
    token = httpx2.post(f"{judge.address}/v1/enrolments", json=enrolment, timeout=PATIENCE_SECONDS).json()["token"]
    files = {side: (f"{side}.jpg", path.read_bytes()) for side, path in PAIRS[0].items()}
    with httpx2.Client(base_url=judge.address, headers={"Authorization": f"Bearer {token}"}, timeout=60) as phone:
        for attempt in range(6):
            metadata = METADATA | {
                "id": str(uuid.uuid4()),
                "time_zone": "Asia/Tokyo" if attempt == 4 else "Asia/Shanghai",
            }
            body = {"metadata": ("m.json", json.dumps(metadata), "application/json")} | files
            with contextlib.suppress(httpx2.TransportError):
                phone.post("/v1/meals", files=body)
        phone.post(f"/v1/meals/{metadata['id']}/events", json={"id": str(uuid.uuid4()), "kind": "comment", "text": "x"})
        phone.get("/v1/me", params={"token": token})
    checks, is_conforming = judge.verdicts("a bad app")
    assert not is_conforming
    assert {name for name, (outcome, _) in checks.items() if outcome == "failed"} == {
        "ids",
        "etags",
        "time_zones",
        "tokens",
    }
    assert checks["safe_resending"][0] == checks["retry_after"][0] == "not_seen"  # until it has had a minute
