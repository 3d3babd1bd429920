"""The storms' own tools: the checker sees what is wrong, the clock moves, the disk is full, the proxy loses answers."""

import contextlib
import errno
import hashlib
import json
import os
import socket
import subprocess
import sys
import threading
import uuid
from datetime import UTC, datetime

import pytest

from app.core.settings import Settings
from app.db.session import Database
from app.meals.job_models import Job
from app.meals.models import Meal, MealImage
from app.storage.opening import open_blob_store
from tests.e2e.faults.disk import Disk
from tests.e2e.faults.invariants import Checker, unexpected_errors
from tests.e2e.faults.launch import faulty_fsync
from tests.e2e.faults.phones import Journal, Planned
from tests.e2e.faults.programs import Clock
from tests.e2e.faults.proxy import Network
from tests.integration.jobs.fakes import new_meal
from tests.support.waiting import PATIENCE_SECONDS, wait_until

AUTOFLUSH = (
    "(raised as a result of Query-invoked autoflush; consider using a session.no_autoflush block if this flush is "
    "occurring prematurely)"
)
PHOTOS = {"left": b"the left photograph", "right": b"the right one"}


class Kept:
    """A meal as a deployment keeps it whose phone was told that it is durable, and the checker over it."""

    def __init__(self, url, folder):
        self.settings = Settings(data_dir=folder / "data", database_url=url, secret_key="k" * 40)
        self.database = Database(url)
        self.blobs = open_blob_store(self.settings.resolved_blob_url, self.settings)
        self.journal = Journal(folder / "timeline.txt")
        with self.database.write() as session:
            meal = new_meal(session)
            meal.status = "failed"
            meal.failure_code = "marker_not_found"
            self.meal_id, client_id = meal.id, meal.client_id
            self.keys = {}
            for slot, content in PHOTOS.items():
                digest = hashlib.sha256(content).hexdigest()
                self.keys[slot] = f"{meal.study_id}/{meal.id}/{slot}/{digest}"
                self.blobs.put_bytes(self.keys[slot], content)
                session.add(image(meal.id, slot, self.keys[slot], digest))
        planned = Planned(client_id, PHOTOS, "whole", [], expects="marker_not_found")
        self.journal.acknowledged[client_id] = ("p", planned)
        self.client_id = client_id

    def problems(self, logs=None):
        checker = Checker(self.settings, self.journal)
        try:
            return checker.problems(logs or {})
        finally:
            checker.close()


def image(meal_id, slot, key, digest):
    return MealImage(
        id=uuid.uuid4(),
        meal_id=meal_id,
        slot=slot,
        media_type="image/jpeg",
        width_px=1,
        height_px=1,
        bytes=1,
        received_sha256=digest,
        stored_sha256=digest,
        blob_key=key,
        received_at=datetime.now(UTC),
    )


@pytest.fixture
def kept(prepared_database_url, tmp_path):
    found = Kept(prepared_database_url, tmp_path)
    yield found
    found.journal.close()
    found.database.dispose()


def test_checker_finds_nothing_where_nothing_is_wrong_and_deletes_and_counts_what_no_row_names(kept):
    assert kept.problems() == ([], [], [])
    folder = kept.keys["left"].rpartition("/")[0]
    kept.blobs.put_bytes(f"{folder}/{hashlib.sha256(b'an orphan').hexdigest()}", b"an orphan")
    checker = Checker(kept.settings, kept.journal)
    try:
        assert checker.problems({}) == ([], [], [])
        assert checker.orphans == 1
    finally:
        checker.close()


def test_checker_sees_an_erased_meal_that_is_there_and_one_that_is_not_there(kept):
    kept.journal.erased.add(kept.client_id)
    kept.journal.acknowledged[uuid.uuid4()] = ("p", Planned(uuid.uuid4(), PHOTOS, "whole", []))
    lost, _, others = kept.problems()
    assert len(lost) == 1
    assert "was acknowledged and is not there" in lost[0]
    assert f"meal {kept.client_id} was erased and is there" in others
    assert "0 erasures in the ledger, and 1 were asked for" in others


def test_checker_sees_photographs_that_are_gone_or_others(kept):
    kept.blobs.delete(kept.keys["left"])
    kept.blobs.put_bytes(kept.keys["right"], b"something else")
    lost, _, others = kept.problems()
    assert [words.partition(": ")[2] for words in lost] == [
        "the bytes of left are not in the store",
        "the store has other bytes of right",
    ]
    assert any("other bytes than its name" in words for words in others)


def test_checker_sees_a_meal_that_still_waits_and_a_job_too_many(kept):
    with kept.database.write() as session:
        session.get_one(Meal, kept.meal_id).status = "processing"
        for _ in range(2):
            now = datetime.now(UTC)
            session.add(Job(id=uuid.uuid4(), meal_id=kept.meal_id, state="queued", attempts=0, enqueued_at=now))
    _, duplicated, others = kept.problems()
    assert [words.partition(" has ")[2] for words in duplicated] == ["2 jobs for meal"]
    assert any("is still processing" in words for words in others)
    assert sum(words.startswith("job ") and words.endswith("is queued") for words in others) == 2


def test_traceback_of_a_bug_is_told_and_one_of_a_database_that_is_away_is_not():
    away = (
        "Traceback (most recent call last):\n  x\n"
        "sqlalchemy.exc.OperationalError: (psycopg.OperationalError) it is away\n[SQL: SELECT"
    )
    bug = "Traceback (most recent call last):\n  x\nKeyError: 'a'"
    told = unexpected_errors({"api0": "\n".join(json.dumps({"exception": each}) for each in (away, bug))})
    assert told == ["api0 logged KeyError: 'a' (1 times)"]
    assert unexpected_errors({"worker0": f"{bug}\n"}) == ["worker0 logged KeyError: 'a' (1 times)"]


@pytest.mark.parametrize(
    ("words", "is_bug"),
    [
        ("app.core.errors.UnavailableError: The machine is too busy", False),
        ("app.storage.blob_store.StoreRefusesError: the clock is wrong", False),
        ("app.core.errors.TadaError: Something went wrong", True),
        ("sqlalchemy.exc.OperationalError: (psycopg.OperationalError) server closed the connection", False),
        ("sqlalchemy.exc.InternalError: (psycopg.errors.IdleInTransactionSessionTimeout) ended", False),
        ("sqlalchemy.exc.OperationalError: (sqlite3.OperationalError) database or disk is full", False),
        ("psycopg.errors.QueryCanceled: canceling statement due to statement timeout", False),
        (f"sqlalchemy.exc.OperationalError: {AUTOFLUSH}\n(psycopg.OperationalError) the connection is lost", False),
        (f"sqlalchemy.exc.ProgrammingError: {AUTOFLUSH}\n(psycopg.errors.SyntaxError) syntax error", True),
        ("sqlalchemy.exc.ProgrammingError: (psycopg.errors.SyntaxError) syntax error", True),
        ("psycopg.errors.UniqueViolation: duplicate key value", True),
        ("sqlalchemy.exc.OperationalError: (sqlite3.OperationalError) no such column: x", True),
        ("sqlite3.IntegrityError: UNIQUE constraint failed", True),
    ],
)
def test_checker_tells_a_database_that_is_away_from_a_statement_that_is_wrong(words, is_bug):
    exception = f"Traceback (most recent call last):\n  x\n{words}\n[SQL: SELECT"
    assert bool(unexpected_errors({"api0": json.dumps({"exception": exception})})) == is_bug


def test_clock_of_a_running_process_jumps_and_its_monotonic_time_goes_on(tmp_path):
    clock = Clock(tmp_path / "clock")
    program = "import sys, time\nfor _ in sys.stdin:\n    print(time.time(), time.monotonic(), flush=True)"
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        env=os.environ | clock.environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )

    def ask():
        process.stdin.write("\n")
        process.stdin.flush()
        return [float(word) for word in process.stdout.readline().split()]

    with process:
        clock.jump(0)
        wall, running = ask()
        clock.jump(-7200)
        wait_until(lambda: ask()[0] < wall - 3600, "the clock to jump", interval_seconds=0.2)
        later_wall, later_running = ask()
    assert later_wall - wall == pytest.approx(-7200 + (later_running - running), abs=60)  # it asks one after the other
    assert 0 <= later_running - running < 600


def test_disk_that_was_filled_takes_nothing_until_it_is_freed(tmp_path):
    switches = tmp_path / "switches"
    switches.mkdir()
    disk = Disk(tmp_path / "disk", switches, 8)
    fsync = faulty_fsync(os.fsync, switches)

    def write():
        with (disk.folder / "file").open("wb") as file:
            file.write(b"x" * 100_000)
            file.flush()
            fsync(file.fileno())

    try:
        disk.fill()
        with pytest.raises(OSError) as refused:  # noqa: PT011  # its errno tells
            write()
        assert refused.value.errno == errno.ENOSPC
        disk.free()
        write()
    finally:
        disk.close()


def test_proxy_that_loses_answers_still_passes_on_what_is_asked():
    listening = socket.create_server(("127.0.0.1", 0))
    asked = []

    def serve():
        connection, _ = listening.accept()
        with connection, contextlib.suppress(ConnectionResetError):  # by the cut, unless it comes later
            while piece := connection.recv(100):
                asked.append(piece)
                connection.sendall(b"answer to " + piece)

    serving = threading.Thread(target=serve, daemon=True)
    serving.start()
    network = Network()
    try:
        link = network.link("test", listening.getsockname()[1])
        with socket.create_connection(("127.0.0.1", link.port)) as caller:
            caller.settimeout(PATIENCE_SECONDS)
            caller.sendall(b"one")
            assert caller.recv(100) == b"answer to one"
            link.loses_answers = True
            caller.sendall(b"two")
            wait_until(lambda: len(asked) == 2, "what is asked")
            assert asked == [b"one", b"two"]
            link.cut()
            with contextlib.suppress(ConnectionResetError):
                assert caller.recv(100) == b""
    finally:
        network.close()
        serving.join(10)
        listening.close()
