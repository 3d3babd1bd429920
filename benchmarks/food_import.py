"""How long `tada foods import sr28` takes, how much memory, and how long others wait for the database meanwhile.

    python benchmarks/food_import.py [--data FOLDER]

On SQLite and on PostgreSQL, each a fresh database. The import is the command itself, in a process of its own; beside it
a second process commits a small row every 50 ms, as uploads do, and tells how long each commit took. The yardstick for
the writing: the same number of rows of the same width into a bare table, in one transaction of the database's own
driver.
"""

import argparse
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import sqlalchemy as sa

from app.core.settings import Settings
from app.db.session import Database
from app.operations.prepare import prepare
from app.people.studies import create_study
from benchmarks.databases import database_url

ROOT = Path(__file__).resolve().parents[1]
PEAK = (
    "import resource, sys; from app.cli.main import main\ntry: main()\nfinally: print('peak_kb', "
)
PEAK += "resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)"
PAUSE_SECONDS = 0.05
VALUES = 679_045


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    release = parser.parse_args().data / "food_tables" / "sr28asc.zip"
    if not release.exists():
        print(f"needs {release}: set TADA_SHARED_DATA")
        return 1
    print(
        "| database | import s | yardstick s | ratio | peak MB | again s | commits beside | p50 ms | p99 ms | max ms |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for kind in ("sqlite", "postgresql"):
        with tempfile.TemporaryDirectory() as folder, database_url(kind, Path(folder)) as url:
            print(row(kind, url, Path(folder), release), flush=True)
    return 0


def row(kind: str, url: str, folder: Path, release: Path) -> str:
    database = Database(url)
    prepare(database, Settings(data_dir=folder))
    yardstick = bare_insert(database)
    database.dispose()
    context = multiprocessing.get_context("spawn")
    waits, stop = context.Queue(), context.Event()
    writer = context.Process(target=write_on, args=(url, stop, waits))
    writer.start()
    seconds, peak_mb = run_import(url, folder, release)
    stop.set()
    waited = sorted(1000.0 * wait for wait in waits.get())
    writer.join()
    again, _ = run_import(url, folder, release)
    p99 = statistics.quantiles(waited, n=100)[98]
    return (
        f"| {kind} | {seconds:.1f} | {yardstick:.1f} | {seconds / yardstick:.1f} | {peak_mb:.0f} | {again:.1f} "
        f"| {len(waited)} | {statistics.median(waited):.1f} | {p99:.0f} | {waited[-1]:.0f} |"
    )


def run_import(url: str, folder: Path, release: Path) -> tuple[float, float]:
    """(seconds, peak MB) of the command."""
    environment = os.environ | {"TADA_DATABASE_URL": url, "TADA_DATA_DIR": str(folder)}
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", PEAK, "foods", "import", "sr28", str(release)],
        env=environment, cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    seconds = time.perf_counter() - start
    return seconds, int(done.stderr.rsplit("peak_kb", 1)[1]) / 1024.0


def write_on(
    url: str, stop: "multiprocessing.synchronize.Event", waits: "multiprocessing.Queue[list[float]]"
) -> None:
    """Commit a row again and again until told to stop; put the time that each commit took."""
    database, taken = Database(url), []
    while not stop.is_set():
        start = time.perf_counter()
        create_study(database, code=f"s{len(taken)}", name="s", marker=None, location_policy="drop")
        taken.append(time.perf_counter() - start)
        time.sleep(PAUSE_SECONDS)
    waits.put(taken)


def bare_insert(database: Database) -> float:
    """Seconds to write as many rows as the release has values into a table without keys."""
    rows = [(number % 8789, number % 150, 1.5) for number in range(VALUES)]
    with database.write_engine.connect() as connection:
        connection.execute(
            sa.text("CREATE TABLE yardstick (a INTEGER, b INTEGER, c DOUBLE PRECISION)")
        )
        connection.commit()
        start = time.perf_counter()
        cursor = connection.connection.cursor()
        mark = "?" if database.is_sqlite else "%s"
        if database.is_sqlite:
            cursor.execute("BEGIN")
        cursor.executemany(f"INSERT INTO yardstick VALUES ({mark}, {mark}, {mark})", rows)
        connection.connection.commit()
        seconds = time.perf_counter() - start
        connection.execute(sa.text("DROP TABLE yardstick"))
        connection.commit()
    return seconds


if __name__ == "__main__":
    sys.exit(main())
