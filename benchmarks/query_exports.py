"""Of benchmarks/query.py: exports by HTTP beside a bare loop over the driver, and what indexes cost who writes."""

import itertools
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

import httpx2
import psycopg
import sqlalchemy as sa

from app.db.session import Database
from app.http.columns.record_columns import RECORD_COLUMNS
from app.meals.stored.record_models import EffectiveRecord, Item
from benchmarks.processes import children_of, processor_seconds
from benchmarks.query_data import DAYS, FIRST_DAY

SMALL_EXPORT, LARGE_EXPORT = 100_000, 1_000_000
FORMATS = ("csv", "ndjson", "parquet")
ROWS_A_FETCH = 2000
WRITTEN = 5000  # records whose insertion is timed
HEAD = (
    "\n| database | export | records | MB | rows/s | a bare loop, rows/s | server, us of processor a row "
    "| PostgreSQL, us a row | server's memory grew by MB |\n|---|---|---|---|---|---|---|---|---|"
)


def exports(
    kind: str, url: str, folder: Path, client: httpx2.Client, token: str, count: int
) -> list[float]:
    """Print a row a format and size; rows a second of the larger ones.

    The bare loop reads the same columns of the same records in the same order by the driver alone, and drops them.
    """
    print(HEAD)
    headers, speeds = {"Authorization": f"Bearer {token}"}, []
    server, postmaster = server_pid(), postmaster_pid(folder)
    for output in FORMATS:  # what it needs is loaded now
        client.get(
            "/v1/records", headers=headers, params={"format": output, "study": "none"}
        ).raise_for_status()
    sizes = sorted({min(SMALL_EXPORT, count), min(LARGE_EXPORT, count)})
    for wanted, output in itertools.product(sizes, FORMATS):
        last = FIRST_DAY + timedelta(days=max(0, round(DAYS * wanted / count) - 1))
        rows, bare_seconds = bare_loop(url, str(last))
        before, worked = (
            start_of_memory(server),
            (processor_seconds([server]), backend_seconds(postmaster)),
        )
        size, started = 0, time.perf_counter()
        with client.stream(
            "GET", "/v1/records", headers=headers, params={"format": output, "to": str(last)}
        ) as answer:
            answer.raise_for_status()
            for piece in answer.iter_raw():
                size += len(piece)
        taken = time.perf_counter() - started
        own = (processor_seconds([server]) - worked[0]) / rows * 1e6
        databases = (backend_seconds(postmaster) - worked[1]) / rows * 1e6
        grown = (memory(server, "VmHWM") - before) / 1024
        print(
            f"| {kind} | {output} | {rows:,} | {size / 1e6:.0f} | {rows / taken:,.0f} | {rows / bare_seconds:,.0f} "
            f"| {own:.1f} | {databases:.1f} | {grown:.0f} |",
            flush=True,
        )
        if wanted == sizes[-1]:
            speeds.append(rows / taken)
    return speeds


def days(kind: str, client: httpx2.Client, token: str) -> None:
    """Print how fast the days of a study come as CSV: a tenth of them."""
    params = {"format": "csv", "to": str(FIRST_DAY + timedelta(days=DAYS // 10))}
    server, started = server_pid(), time.perf_counter()
    before, worked, lines = start_of_memory(server), processor_seconds([server]), 0
    with client.stream(
        "GET", "/v1/days", headers={"Authorization": f"Bearer {token}"}, params=params
    ) as answer:
        answer.raise_for_status()
        for piece in answer.iter_raw():
            lines += piece.count(b"\n")
    taken, own = time.perf_counter() - started, processor_seconds([server]) - worked
    print(
        f"\n{kind}: {lines - 1:,} days as CSV, {(lines - 1) / taken:,.0f} rows/s, {own / lines * 1e6:.0f} us of "
        f"processor a row; the server's memory grew by {(memory(server, 'VmHWM') - before) / 1024:.0f} MB",
        flush=True,
    )


def bare_loop(url: str, last_day: str) -> tuple[int, float]:
    """How many records there are until this day, and the seconds in which the driver alone reads them."""
    stored = EffectiveRecord.__table__.columns
    names = ", ".join(
        name for name in ("item_id", *(column.name for column in RECORD_COLUMNS)) if name in stored
    )
    query = f"SELECT {names} FROM effective_record WHERE local_date <= '{last_day}' ORDER BY captured_at, item_id"
    started, rows = time.perf_counter(), 0
    for batch in _batches_of(url, query):
        rows += len(batch)
    return rows, time.perf_counter() - started


def _batches_of(url: str, query: str) -> Iterator[list[tuple[object, ...]]]:
    if url.startswith("sqlite"):
        connection = sqlite3.connect(str(sa.make_url(url).database))
        cursor = connection.execute(query)
        while batch := cursor.fetchmany(ROWS_A_FETCH):
            yield batch
        connection.close()
        return
    with psycopg.connect(url) as session:
        session.execute(
            "SET enable_sort = off; SET enable_seqscan = off; SET statement_timeout = 0"
        )
        with session.cursor("bare", binary=True) as server_side:
            server_side.execute(query)
            while batch := server_side.fetchmany(ROWS_A_FETCH):
                yield batch


def writing(kind: str, database: Database) -> None:
    """Print what inserting the newest records once more costs, with and without the second indexes; nothing stays.

    Without: on PostgreSQL in the same table, its indexes dropped; on SQLite in an empty table that is like it.
    """
    records, items = EffectiveRecord.__table__, Item.__table__
    new_id = "lower(hex(randomblob(16)))" if database.is_sqlite else "gen_random_uuid()"
    copied = copy_of(records, "item_id", "effective_record")
    with database.write_engine.connect() as connection:

        def timed(table: str) -> float:
            started = time.perf_counter()
            connection.exec_driver_sql(f"INSERT INTO {table} {copied}")
            return (time.perf_counter() - started) / WRITTEN * 1e6

        connection.exec_driver_sql(
            f"CREATE TEMPORARY TABLE fresh AS SELECT item_id AS old_id, {new_id} AS id "
            f"FROM effective_record ORDER BY captured_at DESC, item_id DESC LIMIT {WRITTEN}"
        )
        connection.exec_driver_sql(f"INSERT INTO item {copy_of(items, 'id', 'item')}")
        connection.exec_driver_sql(copied.partition(")")[2])  # what is read is in memory now
        if database.is_sqlite:
            indexed = timed("effective_record")
            sql = connection.exec_driver_sql(
                "SELECT sql FROM sqlite_master WHERE name = 'effective_record'"
            ).scalar()
            bare_sql = (
                str(sql)
                .replace("TABLE effective_record", "TABLE bare", 1)
                .replace("ck_effective_", "ck_bare_")
            )
            connection.exec_driver_sql(
                bare_sql.replace('TABLE "effective_record"', "TABLE bare", 1)
            )
            bare = timed("bare")
        else:
            savepoint = connection.begin_nested()
            indexed = timed("effective_record")
            savepoint.rollback()
            for name in sorted(str(index.name) for index in records.indexes):
                connection.exec_driver_sql(f"DROP INDEX {name}")
            bare = timed("effective_record")
        connection.rollback()
    print(
        f"\n{kind}: a record is inserted in {indexed:.0f} us with {len(records.indexes)} second indexes, "
        f"in {bare:.0f} us without",
        flush=True,
    )


def copy_of(table: sa.FromClause, key: str, name: str) -> str:
    """The rows of table `name` that "fresh" lists, with new keys; behind INSERT INTO."""
    names = table.columns.keys()
    values = ", ".join("fresh.id" if one == key else f"old.{one}" for one in names)
    return f"({', '.join(names)}) SELECT {values} FROM fresh JOIN {name} old ON old.{key} = fresh.old_id"


def server_pid() -> int:
    """The server's process: our child."""
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == os.getpid() and b"serve" in (path / "cmdline").read_bytes():
                return int(path.name)
    raise RuntimeError("no server")


def postmaster_pid(folder: Path) -> int | None:
    path = folder / "postgres" / "postmaster.pid"
    return int(path.read_text().split()[0]) if path.exists() else None


def backend_seconds(postmaster: int | None) -> float:
    """Processor time of PostgreSQL's processes; of SQLite it is the server's own."""
    if postmaster is None:
        return 0.0
    return processor_seconds(children_of(postmaster))


def start_of_memory(pid: int) -> int:
    """Forget the greatest memory until now; what it is now, KB."""
    Path(f"/proc/{pid}/clear_refs").write_text("5")
    return memory(pid, "VmRSS")


def memory(pid: int, name: str) -> int:
    """A line of /proc's status, KB."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(name)).split()[1])
