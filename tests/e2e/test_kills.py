"""SIGKILL at any moment: no accepted meal is lost, none makes two records. Real processes, random but seeded."""

import contextlib
import csv
import hashlib
import io
import json
import os
import pathlib
import random
import signal
import threading
import time
import uuid

import httpx2
import pytest

from tests.e2e.processes import Server, enrolled_client

MEALS = int(os.environ.get("TADA_TEST_MEALS", "16"))  # 50 and more for a long storm by hand (docs/tests.md)
SEED = 20261121
KILLS = max(8, MEALS * 14 // 50)
LONGEST_SECONDS = max(900, 18 * MEALS)
PAIR = pathlib.Path(__file__).parents[2] / "app" / "demo_data"


class Killer(threading.Thread):
    """Kills the server (and with it its worker) or the worker alone, in turns, and starts the server again."""

    def __init__(self, server, rng):
        super().__init__(daemon=True)
        self._server = server
        self._rng = rng
        self._stopping = threading.Event()
        self.killed = {"server": 0, "worker": 0}

    def run(self):
        while sum(self.killed.values()) < KILLS and not self._stopping.wait(self._rng.uniform(0.2, 5.0)):
            if self._rng.random() < 0.5:
                self._server.kill()
                self._server.start()
                self.killed["server"] += 1
                continue
            while not (workers := children_of(self._server.process.pid)) and not self._stopping.wait(0.1):
                pass  # the server has only just begun
            if workers:
                os.kill(workers[0], signal.SIGKILL)
                self.killed["worker"] += 1

    def stop(self):
        self._stopping.set()
        self.join()


def children_of(pid):
    tasks = pathlib.Path(f"/proc/{pid}/task")
    found = [(task / "children").read_text().split() for task in tasks.iterdir()] if tasks.is_dir() else []
    return [int(child) for children in found for child in children]


def send(client, meal_id, deadline):
    """As a phone does: again and again, until it is told that both photographs are durable."""
    metadata = {
        "id": meal_id,
        "captured_at": "2026-11-20T12:30:00+08:00",
        "time_zone": "Asia/Shanghai",
        "hints": [{"point": [1092, 620], "food": "apple"}],
    }
    photos = {slot: (PAIR / f"{slot}.jpg").read_bytes() for slot in ("left", "right")}
    tries = 0
    while time.monotonic() < deadline:
        tries += 1
        files = {"metadata": ("m", json.dumps(metadata).encode(), "application/json")}
        files |= {slot: (slot, content, "image/jpeg") for slot, content in photos.items()}
        try:
            answer = client.post("/v1/meals", files=files)
        except httpx2.TransportError:
            time.sleep(0.2)
            continue
        if answer.status_code in (200, 202):
            images = answer.json()["images"]
            for slot, content in photos.items():
                assert images[slot]["received_sha256"] == hashlib.sha256(content).hexdigest()
                assert images[slot]["durable"] is True
            return tries
        assert answer.json()["retryable"], answer.text
        time.sleep(0.2)
    raise AssertionError(f"meal {meal_id} was not accepted in time, after {tries} tries")


def asked(client, path, deadline, **params):
    while True:
        try:
            return client.get(path, params=params)
        except httpx2.TransportError:
            assert time.monotonic() < deadline
            time.sleep(0.2)


@pytest.mark.slow
def test_no_accepted_meal_is_lost_or_doubled_by_kills_at_any_moment(tmp_path):
    rng = random.Random(SEED)
    deadline = time.monotonic() + LONGEST_SECONDS
    server = Server(tmp_path)
    with contextlib.ExitStack() as cleanup:
        cleanup.callback(server.stop)
        server.start()
        server.wait_until_ready()
        client = cleanup.enter_context(enrolled_client(server))
        kills = random.Random(SEED + 1)  # of its own, or the threads' timing would change what is drawn
        meal_ids = [str(uuid.UUID(int=rng.getrandbits(128), version=4)) for _ in range(MEALS)]
        killer = Killer(server, kills)
        killer.start()
        try:
            tries = []
            for meal_id in meal_ids:
                tries.append(send(client, meal_id, deadline))
                time.sleep(rng.uniform(0.0, 2.0))  # meals do not come all at once, and kills fall between them too
            killer.join(max(0.0, deadline - time.monotonic()))
        finally:
            killer.stop()
        server.wait_until_ready()
        statuses = {}
        for meal_id in meal_ids:
            while True:
                meal = asked(client, f"/v1/meals/{meal_id}", deadline, wait=20).json()
                if meal["status"] not in ("queued", "processing"):
                    break
                assert time.monotonic() < deadline, f"meal {meal_id} is still {meal['status']}:\n{server.log}"
            statuses[meal_id] = meal["failure"]["code"] if meal["failure"] else meal["status"]
        assert set(statuses.values()) == {"estimated"}, statuses
        records = list(csv.DictReader(io.StringIO(client.get("/v1/records", params={"format": "csv"}).text)))
        assert sorted(record["meal_id"] for record in records) == sorted(meal_ids)
        assert "0 differ" in server.tada("records", "rebuild", "--check")
        assert sum(tries) >= MEALS
        assert killer.killed["server"] >= 3
        assert killer.killed["worker"] >= 3
