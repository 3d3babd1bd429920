"""How long one word about a meal takes: a meal of 20 items and 200 events, and a reviewer who goes on.

    python benchmarks/review.py [--items 20] [--events 200] [--words 100] [--only sqlite|postgresql]

On SQLite and on PostgreSQL, each a fresh database. A word is `MealEvents.append`, the transaction and the whole meal of
the answer included: checked, appended, noted, records projected anew. Milliseconds; CPU: the calling thread's own
processor time, which on SQLite is all the work, whatever else the machine does meanwhile.
"""

import argparse
import gc
import hashlib
import random
import sys
import tempfile
import time
import uuid
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

from app.core.settings import Settings
from app.db.session import Database
from app.jobs.queue import JobQueue
from app.meals.estimate.save_estimate import save_estimate
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.run_answer import RunAnswer
from app.operations.prepare import prepare
from app.people.access.caller import StaffCaller
from app.people.models import Device, Participant, Staff, Study
from app.records.read_meal import MealView
from app.records.review.meal_events import MealEvents
from app.records.review.schemas import (
    AnyEventIn,
    CommentIn,
    ConfirmIn,
    SetFoodIn,
    SetMassIn,
    SetShareIn,
)
from benchmarks.databases import database_url

FOODS = (
    "apple",
    "banana",
    "bread-white",
    "potatoes-boiled",
    "milk-whole",
    "chicken-breast",
    "rice-white-cooked",
)
TARGET_MS = 50.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--items", type=int, default=20)
    parser.add_argument("--events", type=int, default=200)
    parser.add_argument("--words", type=int, default=100, help="That are timed.")
    parser.add_argument("--only", choices=["sqlite", "postgresql"])
    arguments = parser.parse_args()
    print(
        f"{'database':<12}{'median':>9}{'p95':>9}{'cpu p50':>9}{'cpu p95':>9}   ms, target {TARGET_MS:.0f}"
    )
    slowest = 0.0
    for kind in [arguments.only] if arguments.only else ["sqlite", "postgresql"]:
        with tempfile.TemporaryDirectory() as name, database_url(kind, Path(name)) as url:
            database = Database(url)
            prepare(database, Settings(data_dir=Path(name)))
            took = time_words(database, arguments.items, arguments.events, arguments.words)
            database.dispose()
        wall, cpu = sorted(one for one, _ in took), sorted(one for _, one in took)
        p95 = int(0.95 * len(took))
        print(f"{kind:<12}{median(wall):>9.1f}{wall[p95]:>9.1f}{median(cpu):>9.1f}{cpu[p95]:>9.1f}")
        slowest = max(slowest, median(wall))
    return 0 if slowest < TARGET_MS else 1


def time_words(
    database: Database, items: int, events: int, words: int
) -> list[tuple[float, float]]:
    """(wall, CPU) milliseconds of each of the last words."""
    reviewer, client_id = lay_table(database, items)
    queue = JobQueue()
    use_case = MealEvents(database, queue)
    drawn = random.Random(1)
    view = say(
        use_case, reviewer, client_id, CommentIn(id=uuid.uuid4(), kind="comment", text="Good.")
    )
    ids = [item.state.item.id for item in view.items]
    took = []
    gc.collect()
    gc.freeze()  # what was imported is no work of the words
    for number in range(events - 1 + words):
        event = random_event(drawn, drawn.choice(ids))
        wall, cpu = time.perf_counter(), time.thread_time()
        say(use_case, reviewer, client_id, event)
        if number >= events - 1:
            took.append((1e3 * (time.perf_counter() - wall), 1e3 * (time.thread_time() - cpu)))
    return took


def random_event(drawn: random.Random, item: uuid.UUID) -> AnyEventIn:
    event_id = uuid.uuid4()
    return drawn.choice(
        [
            SetFoodIn(id=event_id, kind="set_food", item=item, food=drawn.choice(FOODS)),
            SetMassIn(id=event_id, kind="set_mass", item=item, mass_g=drawn.uniform(10.0, 300.0)),
            SetShareIn(id=event_id, kind="set_share", item=item, share=drawn.uniform(0.1, 1.0)),
            ConfirmIn(id=event_id, kind="confirm", item=item),
            CommentIn(id=event_id, kind="comment", item=item, text="As before."),
        ]
    )


def say(
    use_case: MealEvents, reviewer: StaffCaller, client_id: uuid.UUID, event: AnyEventIn
) -> MealView:
    return use_case.append(reviewer, client_id, event, expected=None)[0]


def lay_table(database: Database, items: int) -> tuple[StaffCaller, uuid.UUID]:
    """A reviewer and an estimated meal of so many items."""
    now, client_id, job_id = datetime.now(UTC), uuid.uuid4(), uuid.uuid4()
    study = Study(id=uuid.uuid4(), code="bench", name="bench", created_at=now)
    person = Participant(id=uuid.uuid4(), study_id=study.id, code="P1", created_at=now)
    device = Device(id=uuid.uuid4(), participant_id=person.id, name="phone", enrolled_at=now)
    staff = Staff(id=uuid.uuid4(), name="reviewer", is_admin=True, created_at=now)
    meal = Meal(
        id=uuid.uuid4(), client_id=client_id, study_id=study.id, participant_id=person.id, device_id=device.id,
        captured_at=now, utc_offset_minutes=0, time_zone="UTC", local_date=now.date(), status="processing",
        received_at=now, details={"hints": [{"point": [0, 0], "food": food} for food in FOODS]},
    )  # fmt: skip
    job = Job(
        id=job_id, meal_id=meal.id, purpose="meal", state="processing", attempts=1, enqueued_at=now
    )
    found = {
        "polygon": [[float(x), float(x * x % 100)] for x in range(100)], "volume_ml": 150.0,
        "volume_interval_ml": [120.0, 190.0], "relative_sd": {"pair": 0.02, "item": 0.1}, "candidates": [], "flags": [],
    }  # fmt: skip
    answer: dict[str, Any] = {
        "items": [found | {"hint": number % len(FOODS)} for number in range(items)], "failure": None,
        "marker": "plain:9x7:11", "camera": None, "camera_right": None, "stages": {}, "seconds": 1.0,
        "method": "shape", "pipeline_version": "bench", "parameters": {}, "artefacts": [],
    }  # fmt: skip
    with database.write() as session:
        for row in (study, person, device, staff, meal, job):
            session.add(row)
            session.flush()
        save_estimate(
            session,
            job_id,
            RunAnswer.model_validate(answer),
            hashlib.sha256(job_id.bytes).hexdigest(),
        )
    return StaffCaller(staff.id, staff.name, is_admin=True, token_id=uuid.uuid4()), client_id


if __name__ == "__main__":
    sys.exit(main())
