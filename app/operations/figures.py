"""What /metrics tells of the whole deployment, asked of the database and the store at the scrape: queue, workers, disk.

A scrape never hurts: the answer is kept for some seconds, one thread at most asks, and a scrape waits for it a moment
only. Without an answer in time those figures are left out and `tada_database_up` is 0. Each API process tells the same
figures: take their maximum, not their sum.
"""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
import sqlalchemy.exc
import structlog
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy.pool import QueuePool

from app.core.settings import Settings
from app.db.session import Database
from app.jobs.leases import living_workers
from app.operations.figure_queries import Figures, LastBackup, figures, first_event_at, last_backup
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

KEPT_SECONDS = 10.0  # a figure is that old at most, plus what asking takes
PATIENCE_SECONDS = 2.0  # of a scrape
STATEMENT_MS = 5_000  # PostgreSQL ends a question of ours that takes longer


@dataclass(frozen=True, slots=True)
class Deployment:
    """The answer of the database. workers: version -> how many live. began_at: its first event; None: none yet."""

    figures: Figures
    workers: Counter[str]
    backup: LastBackup | None
    began_at: datetime | None


class DeploymentFigures(Collector):
    """One an API process; ask `collect` from any thread."""

    def __init__(self, database: Database, blobs: BlobStore, settings: Settings) -> None:
        self._database = database
        self._blobs = blobs
        self._settings = settings
        self._lock = threading.Condition()
        self._answer: tuple[float, Deployment | None] | None = None  # when (monotonic), what; None: no answer
        self._is_asking = False

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """All families; those of the database only where it answered."""
        found = self._ask()
        yield _gauge("tada_database_up", "1: the database answered the figures of this scrape.", found is not None)
        yield from _pools(self._database)
        yield from self._disk()
        if found is not None:
            yield from _of_database(found)

    def _ask(self) -> Deployment | None:
        """The answer, at most KEPT_SECONDS old; None where there is none in time."""
        with self._lock:
            if not self._is_fresh() and not self._is_asking:
                self._is_asking = True
                threading.Thread(target=self._look, name="figures", daemon=True).start()
            self._lock.wait_for(self._is_fresh, PATIENCE_SECONDS)
            return self._answer[1] if self._answer is not None and self._is_fresh() else None

    def _is_fresh(self) -> bool:
        return self._answer is not None and time.monotonic() - self._answer[0] < KEPT_SECONDS

    def _look(self) -> None:
        answer = None
        try:
            with self._database.read() as session:
                if not self._database.is_sqlite:
                    session.execute(sa.text(f"SET LOCAL statement_timeout = {STATEMENT_MS}"))
                found, backup, began_at = figures(session), last_backup(session), first_event_at(session)
            workers = Counter(worker.version for worker in living_workers(self._database))
            answer = Deployment(found, workers, backup, began_at)
        except sqlalchemy.exc.SQLAlchemyError as error:
            log.warning("figures_not_told", error=type(error).__name__)
        finally:
            with self._lock:
                self._is_asking = False
                self._answer = (time.monotonic(), answer)
                self._lock.notify_all()

    def _disk(self) -> Iterator[GaugeMetricFamily]:
        try:
            free = self._blobs.free_bytes()
        except OSError:
            return
        yield _gauge("tada_disk_free_bytes", "Room where uploads are written.", free)
        least = self._settings.min_free_bytes
        yield _gauge("tada_disk_least_free_bytes", "Below it uploads are refused (TADA_MIN_FREE_BYTES).", least)


def _of_database(deployment: Deployment) -> Iterator[GaugeMetricFamily]:
    found = deployment.figures
    yield _by("tada_meals", "Meals that are not through yet, by status.", "status", found.meals)
    yield _by("tada_jobs", "Jobs that are not through yet, by state.", "state", found.jobs)
    yield _age("tada_queue_oldest_seconds", "How long the oldest queued job waits.", found.oldest_queued_at, found.now)
    yield _gauge("tada_studies_waiting", "Studies with a meal in the queue.", found.studies_waiting)
    yield _gauge("tada_workers_alive", "Workers that live.", deployment.workers.total())
    yield _by("tada_workers", "Workers that live, by version.", "version", deployment.workers)
    oldest = "How long the oldest of them waits."
    yield _gauge("tada_webhooks_waiting", "Deliveries that are not made yet.", found.deliveries_waiting)
    yield _age("tada_webhooks_oldest_seconds", oldest, found.oldest_delivery_at, found.now)
    yield _gauge("tada_webhooks_disabled", "Webhooks that are disabled.", found.webhooks_disabled)
    yield _gauge("tada_blob_deletions_waiting", "Blobs that an erasure wants gone.", found.deletions_waiting)
    yield _age("tada_blob_deletions_oldest_seconds", oldest, found.oldest_deletion_at, found.now)
    yield from _of_files(found)
    yield from _of_backup(deployment, found.now)


def _of_files(found: Figures) -> Iterator[GaugeMetricFamily]:
    waiting = GaugeMetricFamily(
        "tada_files_waiting", "Exports and releases that are not made yet, by state.", labels=["kind", "state"]
    )
    for kind, files in found.files.items():
        for state, count in files.states.items():
            waiting.add_metric([kind, state], count)
    yield waiting
    yield _by(
        "tada_files_oldest_seconds",
        "How long the oldest of them waits; a release that changes, since the erasure.",
        "kind",
        {kind: _seconds_since(files.oldest_at, found.now) for kind, files in found.files.items()},
    )
    words = "Releases that an erasure wants changed, and that could not be: they are not served."
    yield _gauge("tada_releases_stuck", words, found.releases_stuck)
    words = "Changes of days that the kept sums do not have yet, by whose day it is."
    yield _by("tada_day_marks", words, "whose", found.marked_days)


def _of_backup(found: Deployment, now: datetime) -> Iterator[GaugeMetricFamily]:
    """Told where there is no backup too: an alert on a series that is not there never comes."""
    backup = found.backup
    since, damaged = (backup.made_at, backup.damaged) if backup is not None else (found.began_at, 0)
    yield _age(
        "tada_backup_age_seconds", "Since the last `tada backup`; without one, since the first event.", since, now
    )
    yield _gauge("tada_backup_damaged_blobs", "Blobs that the last `tada backup` lacks: damaged or missing.", damaged)


def _pools(database: Database) -> Iterator[GaugeMetricFamily]:
    """SQLite: connections that write and that read are apart."""
    engines = {"write": database.write_engine, "read": database.read_engine}
    if not database.is_sqlite:
        engines = {"all": database.write_engine}
    pools = {name: engine.pool for name, engine in engines.items() if isinstance(engine.pool, QueuePool)}
    in_use = {name: pool.checkedout() for name, pool in pools.items()}
    most = dict.fromkeys(pools, database.limits.size + database.limits.overflow)
    yield _by("tada_database_connections_in_use", "This process's, at work.", "pool", in_use)
    yield _by("tada_database_connections_most", "This process's, at most.", "pool", most)


def _by(name: str, words: str, label: str, values: Mapping[str, float]) -> GaugeMetricFamily:
    """A family with one label. values: by the label's value."""
    family = GaugeMetricFamily(name, words, labels=[label])
    for labelled, value in values.items():
        family.add_metric([labelled], value)
    return family


def _gauge(name: str, words: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, words, value=float(value))


def _age(name: str, words: str, since: datetime | None, now: datetime) -> GaugeMetricFamily:
    """Seconds since then; 0 where nothing waits."""
    return _gauge(name, words, _seconds_since(since, now))


def _seconds_since(since: datetime | None, now: datetime) -> float:
    return max((now - since).total_seconds(), 0.0) if since is not None else 0.0
