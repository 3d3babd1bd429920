"""A meal through real processes, followed from upload to record and webhook by the log alone; and nobody is in it."""

import json
import pathlib
import uuid

import httpx2
import pytest
from prometheus_client.parser import text_string_to_metric_families

import app
from tests.e2e.processes import Server, free_port, new_phone
from tests.support.receivers import receiver
from tests.support.waiting import wait_until

PHOTOS = pathlib.Path(app.__file__).parent / "demo_data"
MARKED = {
    "participant": "Pmarked1234567",
    "device": "Marked Person's telephone",
    "file": "marked-holiday-beach.jpg",
    "zone": "Pacific/Marquesas",
    "staff": "marked.staff.person",
    "hook": "marked-receiver-path",
}
PATIENCE_SECONDS = 90.0


@pytest.mark.slow
def test_meal_is_followed_by_the_log_alone_which_names_nobody(tmp_path):
    worker_port = free_port()
    server = Server(
        tmp_path,
        TADA_LOG_LEVEL="INFO",
        TADA_WEBHOOK_ALLOW_LOOPBACK="true",
        TADA_WORKER_METRICS_PORT=str(worker_port),
    )
    request_id, client_id = str(uuid.uuid4()), str(uuid.uuid4())
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        with receiver() as hook:
            token = send_meal(server, hook, request_id, client_id)
            lines = wait_for_story(server, request_id)
        addresses = [f"http://127.0.0.1:{port}" for port in (server.port, worker_port)]
        scraped = [httpx2.get(f"{address}/metrics", timeout=PATIENCE_SECONDS) for address in addresses]
        assert httpx2.get(f"{addresses[1]}/healthz", timeout=PATIENCE_SECONDS).json() == {"status": "ok"}
    finally:
        server.stop()
    check_story(lines, request_id.replace("-", ""))
    check_figures(*(answer.text for answer in scraped))
    for secret in (*MARKED.values(), token, client_id):
        assert secret not in server.log, secret
    assert "Traceback" not in server.log


def send_meal(server, hook, request_id, client_id):
    """Everything that a study does before its first meal, and the meal. Returns the phone's token."""
    admin_token = server.create_admin(MARKED["staff"])
    token = new_phone(server.address, admin_token, MARKED["participant"], device_name=MARKED["device"])
    made = httpx2.post(
        f"{server.address}/v1/studies/pilot/webhooks",
        headers={"Authorization": f"Bearer {admin_token}"},
        json={"url": f"http://127.0.0.1:{hook.port}/{MARKED['hook']}", "events": ["*"]},
        timeout=PATIENCE_SECONDS,
    )
    assert made.status_code == 201, made.text
    metadata = {"id": client_id, "captured_at": "2026-11-20T12:30:00-09:30", "time_zone": MARKED["zone"]}
    files = {"metadata": ("m.json", json.dumps(metadata), "application/json")}
    files |= {side: (MARKED["file"], (PHOTOS / f"{side}.jpg").read_bytes(), "image/jpeg") for side in ("left", "right")}
    headers = {"Authorization": f"Bearer {token}", "X-Request-Id": request_id}
    sent = httpx2.post(f"{server.address}/v1/meals", headers=headers, files=files, timeout=60)
    assert sent.status_code == 202, sent.text
    assert sent.headers["x-request-id"] == request_id.replace("-", "")
    return token


def wait_for_story(server, request_id):
    """The log's lines that name the meal, once its estimate's webhook was delivered."""

    def whole_story():
        complete = server.log.rpartition("\n")[0].splitlines()
        lines = [json.loads(line) for line in complete if line.startswith("{")]
        kept = [line for line in lines if line["event"] == "meal_kept"]
        story = [line for line in lines if kept and line.get("meal_id") == kept[0]["meal_id"]]
        delivered = [line for line in story if line["event"] == "webhook_tried" and line["outcome"] == "delivered"]
        webhook_events = {line["webhook_event"] for line in delivered} | estimated(delivered)
        is_whole = {"request", "job_ended"} <= {line["event"] for line in story}
        return is_whole and {"meal.received", "meal.estimated"} <= webhook_events and story

    return wait_until(whole_story, lambda: f"the end of the story:\n{server.log}", patience_seconds=PATIENCE_SECONDS)


def estimated(delivered):
    """A meal that needs review is estimated too."""
    return {"meal.estimated"} if any(line["webhook_event"] == "meal.needs_review" for line in delivered) else set()


def check_story(lines, request_id):
    events = [line["event"] for line in lines]
    assert events.count("meal_kept") == events.count("meal_queued") == events.count("job_ended") == 1
    first_seen = [events.index(name) for name in ("meal_queued", "request", "estimate_saved", "job_ended")]
    assert events.index("job_begins") < events.index("estimate_begun") < events.index("estimate_stage")
    assert events.index("estimate_stage") < events.index("estimate_computed") < events.index("estimate_saved")
    assert first_seen[0] < first_seen[2] < first_seen[3]
    stages = [line["stage"] for line in lines if line["event"] == "estimate_stage"]
    assert {"marker", "disparity", "volume"} <= set(stages)
    upload = next(line for line in lines if line["event"] == "request")
    assert (upload["route"], upload["status"], upload["request_id"]) == ("/v1/meals", 202, request_id)
    assert upload["bytes"] > 100_000
    of_job = [line for line in lines if line["event"].startswith(("job_", "estimate_"))]
    assert len({line["job_id"] for line in of_job}) == 1
    assert {line["request_id"] for line in of_job} == {request_id}
    assert next(line for line in lines if line["event"] == "job_ended")["outcome"] == "ok"


def check_figures(of_server, of_worker):
    """What was just done is counted, each by the process that did it."""
    assert value(of_server, "tada_uploads_total", outcome="kept") == 1
    assert value(of_server, "tada_jobs", state="queued") == 0
    assert value(of_server, "tada_workers_alive") == 1
    assert value(of_worker, "tada_estimates_total", purpose="meal", outcome="ok") == 1
    assert value(of_worker, "tada_estimate_stage_seconds_count", stage="volume") == 1
    assert value(of_worker, "tada_child_results_total", outcome="ok") == 1
    assert value(of_worker, "tada_job_wait_seconds_count") == 1
    assert value(of_worker, "tada_webhook_deliveries_total", outcome="delivered") >= 2
    assert value(of_worker, "tada_chore_done_timestamp_seconds", chore="delete_blobs") > 0
    assert value(of_worker, "tada_worker_heartbeat_timestamp_seconds") > 0


def value(text, name, **labels):
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            if sample.name == name and sample.labels == labels:
                return sample.value
    raise AssertionError(f"no {name} {labels}")
