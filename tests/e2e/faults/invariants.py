"""What must hold when the storm is over, read from database and store directly, past the program's own answers.

Each check returns sentences about what is wrong; none is the aim. Nothing here waits or mends, but that orphans older
than the grace time (here: none) are deleted before the store is compared with the database.
"""

import hashlib
import json
import re
import time
from collections import Counter
from datetime import timedelta

import sqlalchemy as sa

from app.children.child_pool import ChildPoolClosedError
from app.core.errors import StorageFullError, UnavailableError
from app.core.settings import Settings
from app.db.session import Database
from app.db.spent_keys import SpentKey
from app.jobs import queries as jobs
from app.meals.stored.job_models import LIVE_STATES, Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.queries import WAITING
from app.meals.stored.record_models import EffectiveRecord, Item, Run, RunArtefact
from app.people import privacy_queries as privacy
from app.people.access.secret_box import open_secret_box
from app.people.models import Participant
from app.people.privacy_models import BlobDeletion
from app.people.tombstones import digest_of
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.erasure_ledger import ErasureLedger
from app.storage.blob_store import BlobMissingError, StoreRefusesError
from app.storage.opening import open_blob_store

# PostgreSQL's words for: it goes down, comes up, is cut off or full, took too long, or ended one of two for the other
AWAY_OR_IN_THE_WAY = (
    "AdminShutdown|CrashShutdown|CannotConnectNow|ConnectionException|ConnectionFailure|ConnectionTimeout"
    "|QueryCanceled|IdleInTransactionSessionTimeout|LockNotAvailable|DeadlockDetected|SerializationFailure"
    "|DiskFull|IoError|TooManyConnections"
)
SQLITE_IS_FULL_OR_BUSY = "database or disk is full|disk I/O error|database is locked"

OUR_WORDS_FOR_AWAY = "|".join(
    re.escape(f"{error.__module__}.{error.__qualname__}")
    for error in (
        UnavailableError,
        StorageFullError,
        ChildPoolClosedError,
        StoreRefusesError,
    )  # it refuses a wrong clock
)

# what a log may hold of a traceback: parts that were away, and our own words for that
EXPECTED_ERRORS = re.compile(
    rf"^(sqlalchemy\.exc\.\w+: \(psycopg\.(OperationalError|InterfaceError|errors\.({AWAY_OR_IN_THE_WAY}))\)"
    rf"|sqlalchemy\.exc\.OperationalError: \(sqlite3\.OperationalError\) ({SQLITE_IS_FULL_OR_BUSY})"
    rf"|sqlite3\.OperationalError: ({SQLITE_IS_FULL_OR_BUSY})"
    rf"|(sqlalchemy\.exc\.TimeoutError|psycopg\.(OperationalError|errors\.({AWAY_OR_IN_THE_WAY})))\b"
    r"|((ConnectionError|ConnectionResetError|ConnectionRefusedError|BrokenPipeError|TimeoutError|OSError)"
    rf"|obstore\.exceptions\.\w+|{OUR_WORDS_FOR_AWAY})\b)"
)

ERROR_LINE = re.compile(
    r"^(\w+\.)*[A-Z]\w*(Error|Exception|Shutdown|TryAgain|JobLeft|Timeout)\b(:|$)|^(\w+\.)+[A-Z]\w+(:|$)"
)

AUTOFLUSHED = re.compile(r": \(raised as a result of [^\n]*\)\n")  # SQLAlchemy's word before the database's own

# with which a meal fails when the machine was in trouble for too long: no storm is so long for any meal
PASSING_CODES = frozenset(
    {"estimate_killed", "estimate_timed_out", "estimate_out_of_memory", "internal_error", "job_gave_up"}
)

AFTER_ANSWERS = ("estimated", "needs_review")  # both follow from such pictures: whose leftover it is may be in doubt


class Checker:
    """settings: of the deployment, past its proxies. journal: what the phones were told."""

    def __init__(self, settings: Settings, journal) -> None:
        self._settings = settings
        self._journal = journal
        self._database = Database(settings.resolved_database_url)
        self._blobs = open_blob_store(settings.resolved_blob_url, settings)
        self.orphans = self.orphans_before = 0
        self.failed_for_passing_trouble = []

    def close(self):
        self._database.dispose()

    def waiting(self):
        """Meals that are still to be moved."""
        with self._database.read() as session:
            query = sa.select(Meal.client_id, Meal.status, Meal.after_status).where(
                sa.or_(Meal.status.in_(WAITING), Meal.after_status.in_(WAITING))
            )
            return [tuple(row) for row in session.execute(query)]

    def moving(self):
        """Jobs that are not finished: (id, state)."""
        with self._database.read() as session:
            query = sa.select(Job.id, Job.state).where(Job.state.in_(LIVE_STATES))
            return [tuple(row) for row in session.execute(query)]

    def problems(self, logs):
        """All that is wrong; `lost` and `duplicated` are its first two lists."""
        lost, duplicated = self._lost(), self._duplicated()
        others = [*self._stuck(), *self._erased(), *self._answers(), *self._blobs_and_rows(), *unexpected_errors(logs)]
        return lost, duplicated, others

    def _meals(self, session):
        query = sa.select(Meal, Participant.code).join(Participant, Participant.id == Meal.participant_id)
        return {(code, meal.client_id): meal for meal, code in session.execute(query)}

    def _kept(self):
        """Acknowledged meals that nobody erased: (phone's code, planned meal)."""
        return [told for meal_id, told in self._journal.acknowledged.items() if meal_id not in self._journal.erased]

    def _lost(self):
        """Every acknowledged meal is there, with its photographs' very bytes in the store."""
        found = []
        with self._database.read() as session:
            meals = self._meals(session)
            for code, planned in self._kept():
                meal = meals.get((code, planned.meal_id))
                if meal is None:
                    found.append(f"meal {planned.meal_id} was acknowledged and is not there")
                    continue
                query = sa.select(MealImage).where(MealImage.meal_id == meal.id)
                images = {image.slot: image for image in session.scalars(query)}
                sent = dict(planned.photos)
                if planned.meal_id in self._journal.after_acknowledged:
                    sent |= planned.after
                for slot, content in sent.items():
                    digest = hashlib.sha256(content).hexdigest()
                    if slot not in images or images[slot].received_sha256 != digest:
                        found.append(f"meal {planned.meal_id}: the row of {slot} is missing or of other bytes")
                    elif not self._blobs.has(images[slot].blob_key):
                        found.append(f"meal {planned.meal_id}: the bytes of {slot} are not in the store")
                    elif hashlib.sha256(self._blobs.read(images[slot].blob_key)).hexdigest() != digest:
                        found.append(f"meal {planned.meal_id}: the store has other bytes of {slot}")
        return found

    def _duplicated(self):
        """One row a meal, one job a purpose, one run a job that is done, one record an item of the meal's pair."""
        found = []
        with self._database.read() as session:
            seen = Counter(tuple(row) for row in session.execute(sa.select(Meal.participant_id, Meal.client_id)))
            found += [f"meal {key[1]} has {count} rows" for key, count in seen.items() if count > 1]
            jobs_of = Counter(tuple(row) for row in session.execute(sa.select(Job.meal_id, Job.purpose)))
            found += [f"meal {key[0]} has {count} jobs for {key[1]}" for key, count in jobs_of.items() if count > 1]
            states = {row.id: row.state for row in session.execute(sa.select(Job.id, Job.state))}
            runs = set(session.scalars(sa.select(Run.id)))
            done = {job for job, state in states.items() if state == "done"}
            found += [f"job {job} is done and has no run" for job in sorted(done - runs)]
            found += [f"run {run} belongs to a job that is {states.get(run)}" for run in sorted(runs - done)]
            records = Counter(session.scalars(sa.select(EffectiveRecord.item_id)))
            items = set(session.scalars(sa.select(Item.id).where(Item.origin == "pipeline")))
            found += [f"item {item} has {records[item]} records" for item in items if records[item] != 1]
            found += [f"a record of item {item}, which is none of a pair" for item in records.keys() - items]
        return found

    def _stuck(self):
        """No meal waits, and no job is to be done."""
        found = [
            f"meal {meal} is still {status}, its after-meal pair {after}" for meal, status, after in self.waiting()
        ]
        with self._database.read() as session:
            found += [f"job {job} was taken over too often" for job in jobs.exhausted_jobs(session)]
            found += [f"meal {meal} waits without a job" for meal, _ in jobs.waiting_without_live_job(session)]
        return found + [f"job {job} is {state}" for job, state in self.moving()]

    def _answers(self):
        """Each meal has the answer of its own pictures: volumes that follow from their bytes, or its failure."""
        found = []
        with self._database.read() as session:
            meals = self._meals(session)
            for code, planned in self._kept():
                meal = meals.get((code, planned.meal_id))
                if meal is None:
                    continue
                if meal.failure_code in PASSING_CODES:
                    self.failed_for_passing_trouble.append(planned.meal_id)
                if meal.failure_code != planned.expects or (meal.status == "failed") != (planned.expects is not None):
                    found.append(f"meal {planned.meal_id} is {meal.status} ({meal.failure_code})")
                if planned.meal_id in self._journal.after_acknowledged and meal.after_status not in AFTER_ANSWERS:
                    found.append(f"the after-meal pair of {planned.meal_id} is {meal.after_status}")
                query = sa.select(Item.volume_ml).where(Item.meal_id == meal.id, Item.origin == "pipeline")
                volumes = list(session.scalars(query.order_by(Item.position)))
                if planned.volumes_ml is not None and volumes != planned.volumes_ml:
                    found.append(f"meal {planned.meal_id} has {volumes} ml, and its pictures say {planned.volumes_ml}")
                if planned.volumes_ml is None and planned.expects is None and len(volumes) != 1:
                    found.append(f"the real meal {planned.meal_id} has {len(volumes)} items")
        return found

    def _erased(self):
        """What was erased is gone, stands in the ledger and among the tombstones, and nothing else does."""
        box = open_secret_box(self._settings)
        ledger = ErasureLedger(open_blob_store(self._settings.resolved_erasure_url, self._settings), box)
        found = []
        with self._database.read() as session:
            noted = set(ledger.digests("meal"))
            there = {digest_of(box, "meal", "erase", meal.id) for meal in session.scalars(sa.select(Meal))}
            found += [f"a meal stands in the ledger of erasures and is there: {digest}" for digest in noted & there]
            buried = privacy.tombstones_among(session, "meal", noted)
            found += [f"an erasure without a tombstone: {digest}" for digest in noted - buried]
            if len(noted) != len(self._journal.erased):
                found.append(f"{len(noted)} erasures in the ledger, and {len(self._journal.erased)} were asked for")
            meals = self._meals(session)
            found += [
                f"meal {meal_id} was erased and is there"
                for meal_id in self._journal.erased
                if (self._journal.acknowledged[meal_id][0], meal_id) in meals
            ]
        return found

    def _blobs_and_rows(self):
        """After the deletions and without a grace time the store holds what the database names, and nothing else."""
        if self._settings.resolved_blob_url.startswith("s3:"):
            time.sleep(1.1)  # its times have seconds
        with self._database.read() as session:
            self.orphans_before = session.scalar(sa.select(sa.func.count()).select_from(SpentKey))
        deleter = BlobDeleter(self._database, self._blobs)
        deleter.delete_scheduled()
        self.orphans = deleter.delete_orphans(grace=timedelta(0))
        with self._database.read() as session:
            named = set(session.scalars(sa.select(MealImage.blob_key).where(MealImage.erased_at.is_(None))))
            named |= set(session.scalars(sa.select(RunArtefact.blob_key)))
            named |= set(session.scalars(sa.select(Run.result_key)))
            wanted = session.scalars(sa.select(BlobDeletion.blob_key)).all()
        stored = {blob.key for blob in self._blobs.keys("")}
        found = [
            f"a row names {key}, which is not in the store" for key in sorted(named - stored) if not self._is_there(key)
        ]
        found += [f"no row names {key}" for key in sorted(stored - named)]
        found += [f"the deletion of {key} is not carried out" for key in wanted]
        found += [
            f"the store's {key} has other bytes than its name"
            for key in sorted(named & stored)
            if not self._is_whole(key)
        ]
        return found

    def _is_there(self, key):
        """Though the store does not list it: SeaweedFS may forget a folder, not its files, when its disk was full."""
        try:
            return self._is_whole(key)
        except BlobMissingError:
            return False

    def _is_whole(self, key):
        return hashlib.sha256(self._blobs.read(key)).hexdigest() == key.rpartition("/")[2]


def unexpected_errors(logs):
    """Tracebacks in logs whose last line is no part that was away."""
    found = Counter()
    for name, text in logs.items():
        for line in traceback_ends(text):
            if not EXPECTED_ERRORS.match(line):
                found[f"{name} logged {line[:300]}"] += 1
    return [f"{what} ({count} times)" for what, count in found.items()]


def traceback_ends(text):
    """The last line of each traceback: in JSON lines under "exception", else in plain text up to the next JSON line."""
    plain = []
    for line in [*text.splitlines(), "{}"]:
        if not line.startswith("{"):
            plain.append(line)
            continue
        if any(each.startswith("Traceback (most recent call last)") for each in plain):
            yield last_error("\n".join(plain))
        plain = []
        try:
            exception = json.loads(line).get("exception", "")
        except ValueError:  # the disk was full in its midst
            continue
        if exception:
            yield last_error(exception)


def last_error(exception):
    """Its class and words; what SQLAlchemy adds below (the statement, a link) is none of it."""
    exception = AUTOFLUSHED.sub(": ", exception)
    lines = [line for line in exception.splitlines() if ERROR_LINE.match(line)]
    return lines[-1] if lines else exception[-300:]
