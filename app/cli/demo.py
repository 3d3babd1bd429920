"""`tada demo`: one meal from upload to record, over HTTP as a phone does it, on throwaway data."""

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
import tomllib
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from types import FrameType
from zoneinfo import ZoneInfo

import httpx2

from app.core.settings import Settings
from app.db.session import Database
from app.jobs.supervisor import settings_environment
from app.operations.prepare import prepare
from app.people.access.staff import create_admin
from app.people.schemas import EnrolmentCodeOut, EnrolmentOut
from app.records.meal_schemas import MealOut

FOOD_POINT = (1092, 620)  # in the bundled left photograph
MARKER = "plain:9x7:11"
START_SECONDS = 60
ESTIMATE_SECONDS = 180
SHOWN_CANDIDATES = 3
SHOWN_NUTRIENTS = ("ENERC_KCAL", "CHOCDF", "FIBTG", "SUGAR", "PROCNT", "FAT", "K", "VITC")
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
LISTENING = re.compile(r"listens on (http://\S+)")
DATA = importlib.resources.files("app") / "demo_data"


def run_demo(output: Path) -> int:
    """Run the demo, write pictures to `output` and return the exit status."""
    started = time.perf_counter()
    with throwaway_server() as admin:
        study = {"code": "demo", "name": "Demo", "marker": MARKER}
        checked(admin.post("/v1/studies", json=study))
        with enrol(admin, "demo", {"code": "P001"}) as phone:
            say("Created a study, a participant and a phone with its token.")
            meal = send_meal(phone)
            if meal.failure is not None:
                say(f"The meal failed: {meal.failure.message}")
                return 1
            meal = identify_items(phone, meal)
            show_meal(meal)
            show_records(phone)
            save_artefacts(phone, meal, output)
    say(
        f"Done in {time.perf_counter() - started:.0f} s. Pictures of each step are in {output.resolve()}"
    )
    return 0


def say(text: str) -> None:
    """Print one step of the demo."""
    print(f"== {text}", flush=True)


def throwaway_settings(
    folder: Path, *, port: int, host: str = "127.0.0.1", public_url: str | None = None
) -> Settings:
    """Return settings of a server that keeps all of its data in a folder, whatever the environment says."""
    return Settings(
        data_dir=folder,
        database_url=None,
        blob_url=None,
        erasure_url=None,
        public_url=public_url,
        host=host,
        port=port,
        log_level="WARNING",
    )


@contextmanager
def throwaway_server(port: int = 0) -> Iterator[httpx2.Client]:
    """Run a server with its worker on a temporary folder, ignoring the environment; yield an admin's client.

    port 0: any free one.
    """
    with tempfile.TemporaryDirectory(prefix="tada-demo-") as folder:
        settings = throwaway_settings(Path(folder), port=port)
        say("A throwaway server: SQLite and files in a temporary folder, removed at the end.")
        database = Database(settings.resolved_database_url)
        try:
            prepare(database, settings)
            token = create_admin(database, "demo")
        finally:
            database.dispose()
        with running_server(settings) as address, client_of(address, token) as admin:
            say(f"The server and its worker run at {address} (API pages: {address}/docs).")
            yield admin


def serve_until_interrupted(port: int, fill: Callable[[httpx2.Client], object]) -> int:
    """Run a throwaway server, fill it as its admin, and serve it until Ctrl-C.

    Returns the exit status.
    """
    for number in ENDINGS:
        # SIGINT too, since shells make background processes ignore it
        signal.signal(number, _interrupt)
    try:
        with throwaway_server(port) as admin:
            fill(admin)
            say("Ctrl-C ends the server and removes its data.")
            while True:
                time.sleep(3600)
    except KeyboardInterrupt:
        say("Done; the folder is removed.")
    return 0


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """End the server as Ctrl-C does, once: a second signal must not interrupt the removal of the folder."""
    for number in ENDINGS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


@contextmanager
def running_server(settings: Settings) -> Iterator[str]:
    """Run `tada serve` in a separate process; yield its address."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("TADA_")}
    environment |= settings_environment(settings)
    process = subprocess.Popen(
        [sys.executable, "-m", "app.cli", "serve"],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )
    address: list[str] = []
    is_decided = threading.Event()

    def read_errors() -> None:
        for line in process.stderr or ():
            match = LISTENING.search(line)
            if match and not address:
                address.append(match[1])
                is_decided.set()
            elif not match:
                print(line, end="", file=sys.stderr, flush=True)
        is_decided.set()  # the server ended: stop waiting

    reader = threading.Thread(target=read_errors, daemon=True)
    reader.start()
    try:
        if not is_decided.wait(START_SECONDS) or not address:
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


def client_of(address: str | httpx2.URL, token: str) -> httpx2.Client:
    """Return a client that sends this token."""
    return httpx2.Client(base_url=address, headers={"Authorization": f"Bearer {token}"}, timeout=60)


def enrol(admin: httpx2.Client, study: str, participant: Mapping[str, object]) -> httpx2.Client:
    """Create a participant of the study, enrol a phone and return its client."""
    participants, code = f"/v1/studies/{study}/participants", participant["code"]
    checked(admin.post(participants, json=participant))
    issued = checked(admin.post(f"{participants}/{code}/enrolment-codes"))
    enrolment_code = EnrolmentCodeOut.model_validate_json(issued.content).code
    device = {"code": enrolment_code, "device_name": f"phone of {code}", "model": "Sample phone"}
    enrolled = checked(admin.post("/v1/enrolments", json=device))
    return client_of(admin.base_url, EnrolmentOut.model_validate_json(enrolled.content).token)


def send_meal(phone: httpx2.Client) -> MealOut:
    """Upload the bundled pair and follow the meal to its end, printing each stage."""
    metadata = {
        "id": str(uuid.uuid4()),
        "captured_at": datetime.now(ZoneInfo("Asia/Shanghai")).isoformat(timespec="seconds"),
        "time_zone": "Asia/Shanghai",
        "hints": [{"point": FOOD_POINT}],
    }
    meal = upload(
        phone, metadata, {side: bundled_photograph("", side) for side in ("left", "right")}
    )
    durable = all(image.durable for image in meal.images.values())
    say(
        f"Uploaded a meal: both photographs durable: {durable}; hint: an unnamed food at {FOOD_POINT}."
    )
    deadline, printed = time.monotonic() + ESTIMATE_SECONDS, ""
    while meal.status in ("queued", "processing") and time.monotonic() < deadline:
        state = f"{meal.status}: {meal.stage}" if meal.stage else meal.status
        if state != printed:
            print(f"   {state}", flush=True)
            printed = state
        meal = meal_of(phone.get(f"/v1/meals/{meal.id}", params={"wait": 25}))
    print(f"   {meal.status}", flush=True)
    return meal


def bundled_photograph(folder: str, slot: str) -> bytes:
    """Return a photograph of app/demo_data. slot: left, right, after_left or after_right."""
    return (DATA / folder / f"{slot}.jpg").read_bytes()


def upload(
    phone: httpx2.Client, metadata: Mapping[str, object], photographs: Mapping[str, bytes]
) -> MealOut:
    """Send a meal in one request. photographs: by side."""
    parts = {"metadata": ("metadata.json", json.dumps(metadata).encode(), "application/json")}
    parts |= {side: (f"{side}.jpg", content, "image/jpeg") for side, content in photographs.items()}
    return meal_of(phone.post("/v1/meals", files=parts))


def send_event(client: httpx2.Client, meal_id: uuid.UUID, **event: object) -> MealOut:
    """Send one event for the current version of the meal; return the meal after it."""
    path = f"/v1/meals/{meal_id}"
    tag = checked(client.get(path)).headers["ETag"]
    return meal_of(
        client.post(
            f"{path}/events", headers={"If-Match": tag}, json={"id": str(uuid.uuid4()), **event}
        )
    )


def identify_items(phone: httpx2.Client, meal: MealOut) -> MealOut:
    """Print the candidates of each item, and choose the first, as a participant who ate an apple would."""
    for item in meal.items:
        if not item.candidates:
            continue
        say(f"Which food is it? By the index {item.index_version}:")
        for candidate in item.candidates[:SHOWN_CANDIDATES]:
            print(f"   {candidate.probability:6.1%}  {candidate.food.name}")
        if item.none_of_these is not None:
            print(f"   {item.none_of_these:6.1%}  none that the index knows")
        first = item.candidates[0].food
        event = (
            {"kind": "confirm"} if item.food == first else {"kind": "set_food", "food": first.key}
        )
        meal = send_event(phone, meal.id, item=str(item.id), **event)
        say(f"The participant taps {first.name} ({event['kind']}): the meal is {meal.status}.")
    return meal


def show_meal(meal: MealOut) -> None:
    """Print each item: food, volume, mass and nutrients."""
    for item in meal.items:
        print(f"\n   {item.food.name if item.food is not None else 'unknown food'}")
        if item.volume_ml is None or item.volume_interval_ml is None:
            print(f"     not measured: {', '.join(item.flags)}")
            continue
        low, high = item.volume_interval_ml
        print(
            f"     volume      {item.volume_ml:8.1f} ml   (90 % interval {low:.1f} to {high:.1f})"
        )
        if item.mass_g is None or item.mass_interval_g is None:
            continue
        low, high = item.mass_interval_g
        print(f"     density     {item.density_g_per_ml:8.2f} g/ml ({item.density_source})")
        print(f"     mass        {item.mass_g:8.1f} g    (90 % interval {low:.1f} to {high:.1f})")
        print(f"     edible      {item.edible_g:8.1f} g")
        amounts = {nutrient.tagname: nutrient for nutrient in item.nutrients}
        for tagname in SHOWN_NUTRIENTS:
            if tagname in amounts:
                nutrient = amounts[tagname]
                print(f"     {nutrient.name:<31} {nutrient.amount:8.2f} {nutrient.unit}")
    print()


def show_records(phone: httpx2.Client) -> None:
    """Print the size of the records as a researcher's CSV."""
    lines = checked(phone.get("/v1/records", params={"format": "csv"})).text.splitlines()
    say(f"GET /v1/records?format=csv: {len(lines) - 1} record, {lines[0].count(',') + 1} columns.")


def save_artefacts(phone: httpx2.Client, meal: MealOut, output: Path) -> None:
    """Download the pictures of the steps."""
    output.mkdir(parents=True, exist_ok=True)
    for artefact in meal.run.artefacts if meal.run is not None else ():
        (output / artefact.name).write_bytes(checked(phone.get(artefact.href)).content)
        print(f"   {output / artefact.name}")


def meal_of(response: httpx2.Response) -> MealOut:
    """Return the meal in a response. Raises SystemExit as `checked` does."""
    return MealOut.model_validate_json(checked(response).content)


def checked(response: httpx2.Response) -> httpx2.Response:
    """Return the response. Raises SystemExit with the server's text if it is an error."""
    if response.is_error:
        raise SystemExit(f"tada: {response.request.url}: {response.status_code} {response.text}")
    return response


@dataclass(frozen=True, slots=True)
class Person:
    """A participant of the sample study.

    appetite: factor of the dishes' amounts
    keeps: probability of entering a meal and of closing a day
    """

    code: str
    profile: dict[str, object]
    appetite: float
    keeps: float


@dataclass(frozen=True, slots=True)
class Plate:
    """A bundled pair, rendered: its volumes are known.

    folder: below app/demo_data
    points: food's key -> its middle in the left photograph, px
    left_over: the same in its after-meal pair
    """

    folder: str
    points: Mapping[str, list[int]]
    left_over: Mapping[str, list[int]] = field(default_factory=dict)


SAMPLE = tomllib.loads((DATA / "sample_study.toml").read_text("utf-8"))
PEOPLE = tuple(Person(**person) for person in SAMPLE["people"])
PLATES = {name: Plate(**plate) for name, plate in SAMPLE["plates"].items()}
