"""How long the dashboard's pages take, over a million records of which one study has nearly all.

    python -m benchmarks.pages [--part services|http] [--rows N] [--only sqlite|postgresql] [--folder FOLDER --keep]
                               [--samples 40] [--seed 1]

A database made by benchmarks/query_data.py (ONE_STUDY: 95 % of 10,000 participants in one study, a year), in FOLDER
(default: a temporary one), removed at the end unless --keep. First services are called in this process, as pages call
them; then whole pages are asked of a server of its own by a client that is signed in (pages_http.py). TARGET_MS is of a
whole page. "processor" is this process's share of it, which on a busy machine tells more than the time; PostgreSQL's
own work is not in it.
"""

import argparse
import os
import random
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

from app.db.session import Database
from app.diary.day_summaries import list_day_summaries, list_intakes
from app.diary.study_overview import study_overview
from app.http.row_filter import RowFilter
from app.people.access.caller import StaffCaller
from benchmarks import pages_http
from benchmarks.query import PAGE, filled_database, quantile
from benchmarks.query_data import FIRST_DAY, ONE_STUDY, PEOPLE

TARGET_MS = 300.0
STUDY = "study-00"
WINDOW = 28  # days
PAGE_COLUMNS = (
    "| database | page | n | p50 ms | p95 ms | max ms | kB |\n|---|---|---|---|---|---|---|"
)
COLUMNS = "| database | call | n | p50 ms | p95 ms | max ms | processor, p50 ms |\n|---|---|---|---|---|---|---|"


@dataclass(frozen=True)
class Call:
    """Something that a page asks. ask: once, with values at random."""

    name: str
    ask: Callable[[], object]


def calls(database: Database, chance: random.Random) -> Sequence[Call]:
    """What is measured."""
    admin = StaffCaller(uuid.uuid4(), "admin", True, uuid.uuid4())

    def window(days: int) -> tuple[date, date]:
        first = FIRST_DAY + timedelta(days=chance.randrange(ONE_STUDY.days - days + 1))
        return first, first + timedelta(days=days - 1)

    def overview(days: int) -> object:
        first, last = window(days)
        return study_overview(database, admin, STUDY, first_day=first, last_day=last)

    def days(chosen: RowFilter) -> object:
        return list_day_summaries(database, admin, chosen, cursor=None, limit=PAGE)

    def intakes(first: date | None, last: date | None) -> object:
        return list_intakes(
            database, admin, STUDY, first_day=first, last_day=last, cursor=None, limit=PAGE
        )

    return (
        Call("overview, as it opens", lambda: study_overview(database, admin, STUDY)),
        Call("overview, 28 days anywhere", lambda: overview(WINDOW)),
        Call("overview, a year", lambda: overview(ONE_STUDY.days)),
        Call(
            "days of the study", lambda: days(RowFilter(study_code=STUDY, first_day=window(1)[0]))
        ),
        Call(
            "days of a participant",
            lambda: days(
                RowFilter(study_code=STUDY, participant_code=f"P{chance.randrange(PEOPLE):05d}")
            ),
        ),
        Call("intakes, all days", lambda: intakes(None, None)),
        Call("intakes, 28 days", lambda: intakes(*window(WINDOW))),
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--part", choices=("services", "http"), help="One of the two; default: both."
    )
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--only", choices=("sqlite", "postgresql"))
    parser.add_argument("--folder", type=Path, help="Where the databases are made.")
    parser.add_argument("--keep", action="store_true", help="Leave them there, for the next run.")
    parser.add_argument("--samples", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    slowest = 0.0
    for kind in ("sqlite", "postgresql") if arguments.only is None else (arguments.only,):
        with filled_database(
            kind,
            arguments.rows,
            arguments.seed,
            arguments.folder,
            keep=arguments.keep,
            shape=ONE_STUDY,
        ) as (url, folder):
            if arguments.part != "http":
                database = Database(url)
                print(f"\n{COLUMNS}", flush=True)
                for call in calls(database, random.Random(arguments.seed)):
                    slowest = max(slowest, measure(kind, call, arguments.samples))
                database.dispose()
            if arguments.part != "services":
                slowest = max(
                    slowest, measure_pages(kind, url, folder, arguments.samples, arguments.seed)
                )
    print(f"\nload average of the machine: {os.getloadavg()[1]:.1f} on {os.cpu_count()} processors")
    print(f"slowest p95 of what a page asks {slowest:.0f} ms, target {TARGET_MS:.0f} ms")
    return 0 if slowest < TARGET_MS else 1


def measure(kind: str, call: Call, samples: int) -> float:
    """Print a row; the p95, ms."""
    taken, worked = [], []
    call.ask()  # connections and caches
    for _ in range(samples):
        started, busy = time.perf_counter(), time.process_time()
        call.ask()
        taken.append((time.perf_counter() - started) * 1000)
        worked.append((time.process_time() - busy) * 1000)
    p50, p95, most = (quantile(taken, share) for share in (0.5, 0.95, 1.0))
    figures = f"{p50:.0f} | {p95:.0f} | {most:.0f} | {quantile(worked, 0.5):.0f}"
    print(f"| {kind} | {call.name} | {samples} | {figures} |", flush=True)
    return p95


def measure_pages(kind: str, url: str, folder: Path, samples: int, seed: int) -> float:
    """Print a row a page, and what was not measured; the slowest p95, ms."""
    chance = random.Random(seed)
    slowest, missed, left_out = 0.0, list[str](), list[str]()
    print(f"\n{PAGE_COLUMNS}", flush=True)
    with pages_http.signed_in(url, folder) as client:
        database = Database(url)  # after the server has brought it up to date
        asked, unknown = pages_http.page_calls(database, STUDY, ONE_STUDY, chance)
        database.dispose()
        left_out.extend(unknown)
        for call in asked:
            reason = pages_http.why_not(client, call.address())  # and fills caches
            if reason is not None:
                left_out.append(f"{call.name} ({reason})")
                continue
            answers = [pages_http.ask(client, call.address()) for _ in range(samples)]
            taken = [milliseconds for milliseconds, _ in answers]
            p50, p95, most = (quantile(taken, share) for share in (0.5, 0.95, 1.0))
            kilobytes = max(size for _, size in answers) / 1000
            figures = f"{p50:.0f} | {p95:.0f} | {most:.0f} | {kilobytes:.0f}"
            print(f"| {kind} | {call.name} | {samples} | {figures} |", flush=True)
            slowest = max(slowest, p95)
            if p95 >= TARGET_MS:
                missed.append(f"{call.name} ({p95:.0f} ms)")
    print(f"\nnot measured (files, and what needs other data): {', '.join(left_out) or 'nothing'}")
    print(f"over {TARGET_MS:.0f} ms on {kind}: {', '.join(missed) or 'none'}")
    return slowest


if __name__ == "__main__":
    sys.exit(main())
