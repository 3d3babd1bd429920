"""The checker of the storms sees what is wrong, and tells a part that was away from a bug."""

import hashlib
import json
import uuid
from datetime import UTC, datetime

import pytest

from app.core.settings import Settings
from app.db.session import Database
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.storage.opening import open_blob_store
from tests.e2e.faults.invariants import Checker, unexpected_errors
from tests.e2e.faults.phones import Journal, Planned
from tests.integration.jobs.fakes import new_meal

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
