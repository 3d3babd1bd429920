"""How long a backup and its restore take: rows/s, MB/s, peak memory, each beside the plain work of the same machine.

    python -m benchmarks.backup [--meals 5000] [--photo-kb 200] [--folder DIR]

A deployment on SQLite and files is filled with made-up meals of two photographs, then backed up and restored by the
command itself. The yardstick of the blobs: the same bytes copied file by file by `cp -r`, then synced.
"""

import argparse
import hashlib
import json
import os
import pathlib
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import uuid
from datetime import UTC, date, datetime
from typing import Any

from app.core.settings import Settings
from app.db.session import Database
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import Run
from app.operations.prepare import prepare
from app.people.models import Device, Participant, Study
from app.storage.opening import open_blob_store

NOW = datetime(2026, 11, 20, 12, tzinfo=UTC)
SECRET = "k" * 40


def fill(settings: Settings, meals: int, photo_bytes: int) -> int:
    """Bytes of all blobs."""
    database, blobs = (
        Database(settings.resolved_database_url),
        open_blob_store(settings.resolved_blob_url, settings),
    )
    prepare(database, settings)
    study, person, device = uuid.uuid4(), uuid.uuid4(), uuid.uuid4()
    with database.write() as session:
        session.add(Study(id=study, code="pilot", name="Pilot", created_at=NOW))
        session.flush()
        session.add(Participant(id=person, study_id=study, code="P1", created_at=NOW))
        session.flush()
        session.add(Device(id=device, participant_id=person, name="phone", enrolled_at=NOW))
    total = 0
    for first in range(0, meals, 500):
        with database.write() as session:
            for _ in range(first, min(first + 500, meals)):
                meal, run = uuid.uuid4(), uuid.uuid4()
                session.add(
                    Meal(
                        id=meal, client_id=uuid.uuid4(), study_id=study, participant_id=person, device_id=device,
                        captured_at=NOW, utc_offset_minutes=0, time_zone="UTC", local_date=date(2026, 11, 20),
                        details={"hints": []}, status="estimated", received_at=NOW,
                    )
                )  # fmt: skip
                session.flush()
                for slot in ("left", "right"):
                    content = os.urandom(photo_bytes)
                    digest = hashlib.sha256(content).hexdigest()
                    key = f"{study}/{meal}/{slot}/{digest}"
                    path = settings.data_dir / "blobs" / key
                    path.parent.mkdir(parents=True)
                    path.write_bytes(content)
                    total += len(content)
                    session.add(
                        MealImage(
                            id=uuid.uuid4(), meal_id=meal, slot=slot, media_type="image/jpeg", width_px=4, height_px=3,
                            bytes=len(content), received_sha256=digest, stored_sha256=digest, blob_key=key,
                            received_at=NOW,
                        )
                    )  # fmt: skip
                session.add(
                    Job(id=run, meal_id=meal, state="done", enqueued_at=NOW, finished_at=NOW)
                )
                session.flush()
                answer = json.dumps({"run": str(run)}).encode()
                key = f"{study}/{meal}/runs/{run}/result.json/{hashlib.sha256(answer).hexdigest()}"
                blobs.put_bytes(key, answer)
                session.add(
                    Run(
                        id=run, meal_id=meal, method="shape", pipeline_version="1", marker="plain:9x7:11",
                        parameters={}, stages={"read": 0.1}, seconds=1.0, food_releases=[], result_key=key,
                        created_at=NOW,
                    )
                )  # fmt: skip
    database.dispose()
    return total


def run(folder: pathlib.Path, *arguments: object) -> tuple[float, float, dict[str, Any]]:
    """(seconds, peak memory in MB of the largest command so far, answer)."""
    environment = os.environ | {"TADA_DATA_DIR": str(folder), "TADA_SECRET_KEY": SECRET}
    for name in ("TADA_DATABASE_URL", "TADA_BLOB_URL"):
        environment.pop(name, None)
    start = time.perf_counter()
    ended = subprocess.run(
        [sys.executable, "-m", "app.cli", *map(str, arguments), "--json"],
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
    )
    seconds = time.perf_counter() - start
    return (
        seconds,
        resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024,
        json.loads(ended.stdout),
    )


def copied(source: pathlib.Path, target: pathlib.Path) -> float:
    """Seconds of `cp -r` and `sync` of the same files."""
    start = time.perf_counter()
    subprocess.run(["cp", "-r", str(source), str(target)], check=True)
    subprocess.run(["sync", "-f", str(target)], check=True)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--meals", type=int, default=5000)
    parser.add_argument("--photo-kb", type=int, default=200)
    parser.add_argument(
        "--folder", type=pathlib.Path, help="on the disk to be measured; default: a temporary one"
    )
    chosen = parser.parse_args()
    folder = pathlib.Path(tempfile.mkdtemp(prefix="tada-backup-", dir=chosen.folder))
    try:
        settings = Settings(data_dir=folder / "old", secret_key=SECRET)
        total = fill(settings, chosen.meals, chosen.photo_kb * 1024)
        print(f"{chosen.meals} meals, {total / 1e6:.0f} MB of photographs")
        yardstick = copied(folder / "old" / "blobs", folder / "copy")
        shutil.rmtree(folder / "copy")
        print(f"{'':<10} {'seconds':>8} {'MB/s':>7} {'rows/s':>8} {'x cp':>6} {'peak MB':>8}")
        print(f"{'cp + sync':<10} {yardstick:8.1f} {total / 1e6 / yardstick:7.0f}")
        for name, arguments in (
            ("backup", (folder / "old", "backup", folder / "one.tar")),
            ("check", (folder / "old", "restore", folder / "one.tar", "--check")),
            ("restore", (folder / "new", "restore", folder / "one.tar")),
        ):
            seconds, peak, told = run(*arguments)
            print(
                f"{name:<10} {seconds:8.1f} {total / 1e6 / seconds:7.0f} {told['rows'] / seconds:8.0f} "
                f"{seconds / yardstick:6.2f} {peak:8.0f}"
            )
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
