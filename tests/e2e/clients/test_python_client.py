"""clients/python holds the README's conversation, and loses or doubles nothing over a line that drops requests."""

import hashlib
import http.server
import random
import re
import threading
import uuid
import zipfile
from collections import Counter

import pytest
from tada_client import NetworkError, Phone, Problem, RetryPolicy, Staff

from app.extras.reminders.web_push import text_of
from tests.e2e.clients.conftest import CHANGES
from tests.e2e.clients.lossy_line import lossy_line
from tests.e2e.processes import REPOSITORY, enrolment_code
from tests.support.push_services import Browser

PHOTOGRAPHS = REPOSITORY / "app" / "demo_data"
ENDPOINT = "https://push.example.org/send/1"
SEEN_AGAIN = RetryPolicy(first_seconds=0.01)
PATIENT = RetryPolicy(attempts=10, first_seconds=0.01)  # all ten are dropped for one call in ten million

pytestmark = pytest.mark.slow


def test_example_of_the_readme_holds_the_whole_conversation(server, tmp_path, monkeypatch, capsys):
    readme = (REPOSITORY / "clients" / "python" / "README.md").read_text()
    (example,) = re.findall(r"^```python\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
    for name in ("left.jpg", "right.jpg"):
        (tmp_path / name).write_bytes((PHOTOGRAPHS / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    variables = {"server": server.address, "admin_token": server.create_admin("me of the README")}
    exec(example, variables)
    assert capsys.readouterr().out.splitlines()[-1].startswith("Apple")
    assert (tmp_path / "records.csv").read_text().count("\n") == 2


def test_phone_uses_everything_that_a_participant_can_do(server, line, changes_of, tmp_path):
    with Phone(line.address, app_version="test 1", retries=PATIENT) as phone:
        with pytest.raises(Problem, match="unauthenticated"):
            phone.get_me()
        phone.enrol({"code": enrolment_code(server, "P1", line.study, gives_feedback=True), "device_name": "python"})
        assert phone.get_me()["participant"] == "P1"
        assert "parts" in phone.get_server()["features"]
        pair = {side: PHOTOGRAPHS / f"{side}.jpg" for side in ("left", "right")}
        assert phone.check_pair(pair["left"].read_bytes(), pair["right"].read_bytes(), {"locale": "en"})["ok"]
        meal_id, missing, statuses = uuid.uuid4(), [], []
        hint = {"point": [1092, 620], "food": "apple"}
        metadata = {"captured_at": "2026-11-20T12:30:00Z", "time_zone": "Europe/London", "hints": [hint]}
        phone.send_meal(meal_id, metadata, pair, lambda meal: missing.append(meal["missing"]))
        assert missing == [["left", "right"], ["right"], []]
        assert phone.send_meal(meal_id, metadata, {})["missing"] == []
        meal = phone.wait_for_estimate(meal_id, on_change=lambda meal: statuses.append(meal["status"]))
        assert (meal["status"], statuses[-1]) == ("estimated", "estimated")
        assert phone.get_meal(meal_id, meal["version"]) is None
        event = {"id": str(uuid.uuid4()), "kind": "confirm", "item": meal["items"][0]["id"]}
        confirmed = phone.send_event(meal, event)
        assert phone.send_event(meal, event)["version"] == confirmed["version"]
        with pytest.raises(Problem, match="precondition_failed"):
            phone.send_event(meal, event | {"id": str(uuid.uuid4())})
        # a pair that the server has no estimate of yet: there must be one to cancel
        after = {f"after_{side}": path.read_bytes() + b"after" for side, path in pair.items()}
        phone.send_after(meal_id, {"captured_at": "2026-11-20T12:50:00Z"}, after)
        assert phone.get_meal(meal_id)["after"]["missing"] == []
        phone.cancel_estimate(meal_id)
        assert phone.wait_for_estimate(meal_id, "after")["after"]["status"] == "failed"
        assert phone.get_food(phone.search_foods("apple", 5)[0]["key"])["key"] == "apple"
        assert (phone.get_vessels(), phone.get_questions()) == ([], [])
        (day,) = phone.get_days("2026-11-20", "2026-11-20")
        assert phone.put_day(day["date"], day["version"], {"status": "closed"})["status"] == "closed"
        assert phone.get_summary(day["date"])["meals"]
        assert phone.download_photograph(meal_id, "left", tmp_path / "small.jpg", 320).stat().st_size > 1000
        artefact = phone.download_artefact(meal_id, meal["run"]["artefacts"][0]["name"], tmp_path / "artefact")
        assert artefact.stat().st_size > 0
        receiver = Browser().receiver
        keys = {"p256dh": text_of(receiver.public_key), "auth": text_of(receiver.auth)}
        reminders = {
            "subscription": {"endpoint": ENDPOINT, "keys": keys},
            "times": ["12:30"],
            "time_zone": "Europe/London",
        }
        assert phone.put_reminders(reminders)["times"] == phone.get_reminders()["times"] == ["12:30"]
        phone.delete_reminders()
        assert not phone.get_reminders()["subscribed"]
        assert zipfile.ZipFile(phone.download_my_export(tmp_path / "mine.zip")).testzip() is None
        assert phone.delete_meal(meal_id) == phone.delete_meal(meal_id)
        assert list(phone.list_meals()) == []
        receipt = phone.withdraw()
        assert (phone.get_receipt(receipt["id"]), phone.withdraw()) == (receipt, receipt)
        with pytest.raises(Problem, match="withdrawn") as refused:
            phone.get_me()
        assert (refused.value.status, refused.value.retryable) == (410, False)
    assert changes_of(line.study) == CHANGES + Counter({"meal.cancel": 1})


def test_lost_answers_to_enrolment_and_withdrawal_come_again(server, staff):
    code = enrolment_code(server, "P3", "all")
    enrolment = {"code": code, "device_name": "python", "secret": "kept by the program " * 2}
    with lossy_line(server.address, share=0, loses_first_answers=True) as line:
        with Phone(line.address, retries=RetryPolicy(attempts=1)) as ended, pytest.raises(NetworkError):
            ended.enrol(enrolment)
        with Phone(line.address, retries=SEEN_AGAIN) as phone:
            phone.enrol(enrolment)
            devices = staff.call("GET", "/v1/studies/all/devices")["items"]
            assert [device["id"] for device in devices if device["participant"] == "P3"] == [
                phone.get_me()["device"]["id"]
            ]
            receipt = phone.withdraw()
            assert (receipt["what"], phone.get_receipt(receipt["id"])) == ("participant", receipt)
        assert line.dropped["after"] == 4  # enrolments, me, withdrawal, receipt


LARGE = (PHOTOGRAPHS / "left.jpg").read_bytes() + random.Random(1).randbytes(5 * 1024**2)
TWENTY_PAST = {"captured_at": "2026-11-20T12:20:00Z", "time_zone": "Europe/London"}


@pytest.fixture
def large_meal(server):
    """A phone, and its meal of which one large photograph is missing."""
    with Phone(server.address, retries=SEEN_AGAIN) as phone:
        phone.enrol({"code": enrolment_code(server, f"P{uuid.uuid4()}", "large"), "device_name": "python"})
        meal = phone.put_meal(uuid.uuid4(), TWENTY_PAST | {"views": 1})
        yield phone, meal["id"]


def test_large_photograph_continues_where_the_line_broke_and_after_the_program_has_ended(server, large_meal, tmp_path):
    phone, meal_id = large_meal
    file = tmp_path / "left.jpg"
    file.write_bytes(LARGE)
    with lossy_line(server.address, share=0, broken_bodies=[1_900_000]) as line:
        once = RetryPolicy(attempts=1)
        with Phone(line.address, phone.token, retries=once) as ended, pytest.raises(NetworkError):
            ended.put_photograph(meal_id, "left", LARGE)
        line.broken_bodies += [700_000, 1_400_000, 300_000]
        with Phone(line.address, phone.token, retries=SEEN_AGAIN) as sending:
            meal = sending.put_photograph(meal_id, "left", file)
        assert line.broken_bodies == []
        assert line.photograph_bytes < len(LARGE) + 500_000  # from the start it would have been 4,300,000 more
    image = meal["images"]["left"]
    assert (image["durable"], image["received_sha256"]) == (True, hashlib.sha256(LARGE).hexdigest())


def test_large_photograph_is_sent_whole_to_a_server_without_pieces(server, large_meal):
    phone, meal_id = large_meal
    with (
        lossy_line(server.address, share=0, unknown="/upload$") as line,
        Phone(line.address, phone.token) as sending,
    ):
        meal = sending.put_photograph(meal_id, "left", LARGE)
        assert line.photograph_bytes == len(LARGE)
    assert meal["images"]["left"]["received_sha256"] == hashlib.sha256(LARGE).hexdigest()


def test_large_photograph_whose_last_answer_is_lost_is_not_sent_again(server, large_meal):
    phone, meal_id = large_meal
    short = LARGE[:1_500_000]  # one piece
    with lossy_line(server.address, share=0, loses_first_answers=True) as line:
        with Phone(line.address, phone.token, retries=SEEN_AGAIN) as sending:
            meal = sending.put_photograph(meal_id, "left", short)
        assert line.photograph_bytes == len(short)
    assert meal["images"]["left"]["received_sha256"] == hashlib.sha256(short).hexdigest()


OTHER = random.Random(2).randbytes(4 * 1024**2) + LARGE[4 * 1024**2 :]  # of the same length, and no photograph


@pytest.mark.parametrize("other", [LARGE + LARGE, LARGE[:2_000_000], OTHER], ids=["longer", "shorter", "as long"])
def test_upload_that_was_begun_with_another_file_is_not_continued(server, large_meal, other):
    phone, meal_id = large_meal
    with lossy_line(server.address, share=0) as line:
        line.broken_bodies += [1_900_000]
        with Phone(line.address, phone.token, retries=RetryPolicy(attempts=1)) as ended, pytest.raises(NetworkError):
            ended.put_photograph(meal_id, "left", other)
    assert phone.put_photograph(meal_id, "left", LARGE)["images"]["left"]["durable"]
    (image,) = phone.get_meal(meal_id)["images"].values()
    assert image["received_sha256"] == hashlib.sha256(LARGE).hexdigest()


@pytest.mark.parametrize("headers", [{}, {"Upload-Offset": "x", "Upload-Length": "5"}])
def test_answer_of_a_sign_in_page_is_a_network_error(headers):
    class Portal(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Portal) as portal:
        thread = threading.Thread(target=portal.serve_forever, daemon=True)
        thread.start()
        retries = RetryPolicy(attempts=2, first_seconds=0)
        address = f"http://127.0.0.1:{portal.server_port}"
        with Phone(address, "token", retries=retries) as phone, pytest.raises(NetworkError):
            phone.put_photograph(uuid.uuid4(), "left", LARGE)
        portal.shutdown()
        thread.join(10)


MEALS, DECLARED = 10, 8


@pytest.fixture(scope="module")
def sent_over_a_lossy_line(server):
    """The phone's pictures by meal; meals that were declared; the line as it was."""
    left, right = ((PHOTOGRAPHS / f"{side}.jpg").read_bytes() for side in ("left", "right"))
    code = enrolment_code(server, "P2", "lossy")
    with lossy_line(server.address) as line, Phone(line.address, retries=SEEN_AGAIN) as phone:
        with Phone(server.address) as enrolling:
            phone.token = enrolling.enrol({"code": code, "device_name": "python"})["token"]
        sent, declared = {}, []
        for number in range(MEALS):
            meal_id = str(uuid.uuid4())
            metadata = {"captured_at": f"2026-11-20T12:{number:02}:00Z", "time_zone": "Europe/London"}
            sent[meal_id] = {"left": left + bytes([number]), "right": right + bytes([number])}
            meal = phone.send_meal(meal_id, metadata, sent[meal_id])
            assert meal["missing"] == []
            phone.cancel_estimate(meal_id)
        for number in range(DECLARED):
            when = {"captured_at": f"2026-11-21T12:{number:02}:00Z", "time_zone": "Europe/London"}
            meal = phone.declare_meal({"id": str(uuid.uuid4()), **when, "items": [{"food": "apple"}]})
            meal = phone.send_event(meal, {"kind": "set_mass", "item": meal["items"][0]["id"], "mass_g": 100 + number})
            day = phone.put_day(f"2026-10-{number + 1:02}", 0, {"status": "closed", "ate_nothing": True})
            assert day["version"] == 1
            declared.append(meal["id"])
        yield sent, declared, line


def test_no_meal_photograph_or_event_is_lost_or_doubled(sent_over_a_lossy_line, staff):
    sent, declared, line = sent_over_a_lossy_line
    assert 0.1 < sum(line.dropped.values()) / line.requests < 0.3
    assert all(line.dropped.values()), line.dropped
    meals = [meal["id"] for meal in staff.list_meals(study="lossy", limit=7)]
    assert sorted(meals) == sorted([*sent, *declared])
    rows = [(row["meal_id"], row["slot"], row["received_sha256"]) for row in staff.list_photographs("lossy", limit=7)]
    assert sorted(rows) == sorted(
        (meal_id, slot, hashlib.sha256(content).hexdigest())
        for meal_id, photographs in sent.items()
        for slot, content in photographs.items()
    )
    for number, meal_id in enumerate(declared):
        events = staff.call("GET", f"/v1/meals/{meal_id}/events")["items"]
        assert [event["new"]["mass_g"] for event in events if event["kind"] == "set_mass"] == [100 + number]


def test_records_changes_and_files_come_whole_over_a_lossy_line(sent_over_a_lossy_line, server, staff, tmp_path):
    _, declared, _ = sent_over_a_lossy_line
    with lossy_line(server.address, seed=2) as line, Staff(line.address, staff.token, retries=SEEN_AGAIN) as reader:
        records = list(reader.list_records(study="lossy", limit=3))
        assert sorted(record["meal_id"] for record in records) == sorted(declared)
        changed = [record["id"] for page in reader.list_changes("lossy") for record in page["records"]]
        assert sorted(changed) == sorted(record["id"] for record in records)
        for number in range(5):
            saved = reader.download_records(tmp_path / f"{number}.csv", study="lossy").read_text()
            assert saved.count("\n") == DECLARED + 1
        made = reader.export("lossy", {"rows": "items"}, tmp_path / "export.csv")
        assert (made["state"], (tmp_path / "export.csv").read_text().count("\n")) == ("done", DECLARED + 1)
        assert sum(line.dropped.values()) >= 2
        assert list(tmp_path.glob("*.part")) == []


def test_without_a_server_a_network_error_comes_after_the_last_attempt():
    once_more = RetryPolicy(attempts=2, first_seconds=0)
    with Phone("http://127.0.0.1:9", retries=once_more) as phone, pytest.raises(NetworkError):
        phone.get_server()
