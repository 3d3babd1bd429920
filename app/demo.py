"""`tada demo`: one meal from upload to record, over HTTP as a phone would, on throwaway data."""

import importlib.resources
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import httpx2

from app.db.session import Database
from app.jobs.supervisor import settings_environment
from app.services.prepare import prepare
from app.services.staff import create_admin
from app.settings import Settings

FOOD_POINT = (1092, 620)  # in the bundled left photograph
MARKER = "plain:9x7:11"
START_SECONDS = 60
ESTIMATE_SECONDS = 180
SHOWN_CANDIDATES = 3
SHOWN_NUTRIENTS = ("ENERC_KCAL", "CHOCDF", "FIBTG", "SUGAR", "PROCNT", "FAT", "K", "VITC")
LISTENING = re.compile(r"listens on (http://\S+)")


def run_demo(output: Path) -> int:
    """Run it; pictures go to `output`. Returns the exit status."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="tada-demo-") as folder:
        settings = throwaway_settings(Path(folder))
        say("A throwaway server: SQLite and files in a temporary folder.")
        database = Database(settings.resolved_database_url)
        try:
            prepare(database, settings)
            admin_token = create_admin(database, "demo")
        finally:
            database.dispose()
        with running_server(settings) as address, httpx2.Client(base_url=address, timeout=60) as client:
            say(f"The server and its worker run at {address} (API pages: {address}/docs).")
            token = enrol(client, admin_token)
            say("A study, a participant and a phone with its token are there.")
            meal = send_meal(client, token)
            if meal["status"] == "failed":
                say(f"The meal failed: {meal['failure']}")
                return 1
            meal = say_what_it_is(client, token, meal)
            show_meal(meal)
            show_records(client, token)
            save_artefacts(client, token, meal, output)
    say(f"Done in {time.perf_counter() - started:.0f} s. Pictures of each step are in {output.resolve()}")
    return 0


def throwaway_settings(folder: Path, port: int = 0) -> Settings:
    """A server of its own in this folder, whatever the environment says of another."""
    return Settings(
        data_dir=folder,
        database_url=None,
        blob_url=None,
        erasure_url=None,
        public_url=None,
        port=port,
        log_level="WARNING",
    )


def say(text: str) -> None:
    """One step of the demo, told."""
    print(f"== {text}", flush=True)


@contextmanager
def running_server(settings: Settings, *arguments: str) -> Iterator[str]:
    """`tada serve` with these arguments as a process of its own; yields its address, ends it at the end."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("TADA_")}
    environment |= settings_environment(settings)
    process = subprocess.Popen(
        [sys.executable, "-m", "app.cli", "serve", *arguments], env=environment, stderr=subprocess.PIPE, text=True
    )
    address: list[str] = []
    found = threading.Event()

    def read_errors() -> None:
        for line in process.stderr or ():
            match = LISTENING.search(line)
            if match and not address:
                address.append(match[1])
                found.set()
            elif not match:
                print(line, end="", file=sys.stderr, flush=True)
        found.set()  # the server ended: stop waiting

    reader = threading.Thread(target=read_errors, daemon=True)
    reader.start()
    try:
        if not found.wait(START_SECONDS) or not address:
            raise SystemExit("tada: the demo's server did not start; its messages are above.")
        yield address[0]
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        reader.join(5)


def enrol(client: httpx2.Client, admin_token: str) -> str:
    """Make a study and a participant, enrol a phone: its token."""
    admin = {"Authorization": f"Bearer {admin_token}"}
    answer(client.post("/v1/studies", headers=admin, json={"code": "demo", "name": "Demo", "marker": MARKER}))
    answer(client.post("/v1/studies/demo/participants", headers=admin, json={"code": "P001"}))
    code = answer(client.post("/v1/studies/demo/participants/P001/enrolment-codes", headers=admin))["code"]
    token: str = answer(client.post("/v1/enrolments", json={"code": code, "device_name": "demo phone"}))["token"]
    return token


def send_meal(client: httpx2.Client, token: str) -> dict[str, Any]:
    """Upload the bundled pair and follow it to its end, telling each stage."""
    phone = {"Authorization": f"Bearer {token}"}
    metadata = {
        "id": str(uuid.uuid4()),
        "captured_at": datetime.now(ZoneInfo("Asia/Shanghai")).isoformat(timespec="seconds"),
        "time_zone": "Asia/Shanghai",
        "hints": [{"point": FOOD_POINT}],
    }
    bundled = importlib.resources.files("app") / "demo_data"
    parts = {"metadata": ("metadata.json", json.dumps(metadata).encode(), "application/json")}
    for side in ("left", "right"):
        parts[side] = (f"{side}.jpg", (bundled / f"{side}.jpg").read_bytes(), "image/jpeg")
    meal = answer(client.post("/v1/meals", headers=phone, files=parts))
    durable = all(image["durable"] for image in meal["images"].values())
    say(f"Uploaded a meal: both photographs durable: {durable}; hint: a food at {FOOD_POINT}, not which.")
    deadline, seen = time.monotonic() + ESTIMATE_SECONDS, None
    while meal["status"] in ("queued", "processing") and time.monotonic() < deadline:
        state = (meal["status"], meal["stage"])
        if state != seen:
            print(f"   {meal['status']}{': ' + meal['stage'] if meal['stage'] else ''}", flush=True)
            seen = state
        meal = answer(client.get(f"/v1/meals/{meal['id']}", headers=phone, params={"wait": 25}))
    print(f"   {meal['status']}", flush=True)
    return meal


def say_what_it_is(client: httpx2.Client, token: str, meal: dict[str, Any]) -> dict[str, Any]:
    """Print what the server takes each item for, and tap the first of it, as a participant would who sees an apple."""
    phone = {"Authorization": f"Bearer {token}"}
    for item in [each for each in meal["items"] if each["candidates"]]:
        say(f"Which food is it? By the index {item['index_version']}:")
        for candidate in item["candidates"][:SHOWN_CANDIDATES]:
            print(f"   {candidate['probability']:6.1%}  {candidate['food']['name']}")
        print(f"   {item['none_of_these']:6.1%}  none that the index knows")
        first = item["candidates"][0]["food"]
        word = {"kind": "confirm"} if item["food"] == first else {"kind": "set_food", "food": first["key"]}
        event = {"id": str(uuid.uuid4()), "item": item["id"], **word}
        path = f"/v1/meals/{meal['id']}"
        as_read = {"If-Match": client.get(path, headers=phone).raise_for_status().headers["ETag"]}
        meal = answer(client.post(f"{path}/events", headers=phone | as_read, json=event))
        say(f"The participant taps {first['name']} ({word['kind']}): the meal is {meal['status']}.")
    return meal


def show_meal(meal: dict[str, Any]) -> None:
    """Print what was found."""
    for item in meal["items"]:
        food = item["food"]["name"] if item["food"] else "unknown food"
        print(f"\n   {food}")
        if item["volume_ml"] is None:
            print(f"     not measured: {', '.join(item['flags'])}")
            continue
        low, high = item["volume_interval_ml"]
        print(f"     volume      {item['volume_ml']:8.1f} ml   (90 % interval {low:.1f} to {high:.1f})")
        if item["mass_g"] is None:
            continue
        low, high = item["mass_interval_g"]
        print(f"     density     {item['density_g_per_ml']:8.2f} g/ml ({item['density_source']})")
        print(f"     mass        {item['mass_g']:8.1f} g    (90 % interval {low:.1f} to {high:.1f})")
        print(f"     edible      {item['edible_g']:8.1f} g")
        amounts = {nutrient["tagname"]: nutrient for nutrient in item["nutrients"]}
        for tagname in SHOWN_NUTRIENTS:
            if tagname in amounts:
                nutrient = amounts[tagname]
                print(f"     {nutrient['name']:<31} {nutrient['amount']:8.2f} {nutrient['unit']}")
    print()


def show_records(client: httpx2.Client, token: str) -> None:
    """Print the record as a researcher's CSV."""
    phone = {"Authorization": f"Bearer {token}"}
    lines = client.get("/v1/records", headers=phone, params={"format": "csv"}).text.splitlines()
    say(f"GET /v1/records?format=csv: {len(lines) - 1} record, {lines[0].count(',') + 1} columns.")


def save_artefacts(client: httpx2.Client, token: str, meal: dict[str, Any], output: Path) -> None:
    """Download the pictures of the steps."""
    output.mkdir(parents=True, exist_ok=True)
    for artefact in meal["run"]["artefacts"]:
        content = client.get(artefact["href"], headers={"Authorization": f"Bearer {token}"}).raise_for_status().content
        (output / artefact["name"]).write_bytes(content)
        print(f"   {output / artefact['name']}")


def answer(response: httpx2.Response) -> dict[str, Any]:
    """The body of a good answer; a bad one ends the demo with its sentence."""
    if response.is_error:
        raise SystemExit(f"tada: {response.request.url}: {response.status_code} {response.text}")
    body: dict[str, Any] = response.json() if response.content else {}
    return body
