"""The figures of the whole deployment in /metrics, read from database and store at the scrape: queue, workers, disk.

Scrapes are cheap: results are cached for some seconds, at most one thread queries, and a scrape
waits only briefly. Without a result in time those figures are left out and `tada_database_up` is 0.
Each API process reports the same figures: take their maximum, not their sum.
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
from app.operations.queries import Figures, LastBackup, figures, first_event_at, last_backup
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

CACHE_SECONDS = 10.0  # maximum age of a figure, beside the duration of the query
PATIENCE_SECONDS = 2.0  # of a scrape
STATEMENT_MS = 5_000  # PostgreSQL: maximum time of a query


@dataclass(frozen=True, slots=True)
class Deployment:
    """Figures from the database.

    workers: version -> number alive. began_at: its first event; None: none yet.
    """

    figures: Figures
    workers: Counter[str]
    backup: LastBackup | None
    began_at: datetime | None


class DeploymentFigures(Collector):
    """One per API process; `collect` is thread-safe."""

    def __init__(self, database: Database, blobs: BlobStore, settings: Settings) -> None:
        self._database = database
        self._blobs = blobs
        self._settings = settings
        self._lock = threading.Condition()
        # time (monotonic), figures; None: no result
        self._cached: tuple[float, Deployment | None] | None = None
        self._is_querying = False

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield all families; those of the database only if it answered."""
        deployment = self._fetch()
        yield _gauge(
            "tada_database_up",
            "1: the database answered the figures of this scrape.",
            deployment is not None,
        )
        yield from _pools(self._database)
        yield from self._disk()
        if deployment is not None:
            yield from _of_database(deployment)

    def _fetch(self) -> Deployment | None:
        """Return the figures, at most CACHE_SECONDS old; None if they do not arrive in time."""
        with self._lock:
            if not self._is_fresh() and not self._is_querying:
                self._is_querying = True
                threading.Thread(target=self._query, name="figures", daemon=True).start()
            self._lock.wait_for(self._is_fresh, PATIENCE_SECONDS)
            return self._cached[1] if self._cached is not None and self._is_fresh() else None

    def _is_fresh(self) -> bool:
        return self._cached is not None and time.monotonic() - self._cached[0] < CACHE_SECONDS

    def _query(self) -> None:
        deployment = None
        try:
            with self._database.read() as session:
                if not self._database.is_sqlite:
                    session.execute(sa.text(f"SET LOCAL statement_timeout = {STATEMENT_MS}"))
                current, backup, began_at = (
                    figures(session),
                    last_backup(session),
                    first_event_at(session),
                )
            workers = Counter(worker.version for worker in living_workers(self._database))
            deployment = Deployment(current, workers, backup, began_at)
        except sqlalchemy.exc.SQLAlchemyError as error:
            log.warning("figures_not_told", error=type(error).__name__)
        finally:
            with self._lock:
                self._is_querying = False
                self._cached = (time.monotonic(), deployment)
                self._lock.notify_all()

    def _disk(self) -> Iterator[GaugeMetricFamily]:
        try:
            free = self._blobs.free_bytes()
        except OSError:
            return
        yield _gauge("tada_disk_free_bytes", "Room where uploads are written.", free)
        least = self._settings.min_free_bytes
        yield _gauge(
            "tada_disk_least_free_bytes",
            "Below it uploads are refused (TADA_MIN_FREE_BYTES).",
            least,
        )


def _of_database(deployment: Deployment) -> Iterator[GaugeMetricFamily]:
    figures = deployment.figures
    yield _by("tada_meals", "Meals that are not through yet, by status.", "status", figures.meals)
    yield _by("tada_jobs", "Jobs that are not through yet, by state.", "state", figures.jobs)
    yield _age(
        "tada_queue_oldest_seconds",
        "How long the oldest queued job waits.",
        figures.oldest_queued_at,
        figures.now,
    )
    yield _gauge(
        "tada_studies_waiting", "Studies with a meal in the queue.", figures.studies_waiting
    )
    yield _gauge("tada_workers_alive", "Workers that live.", deployment.workers.total())
    yield _by("tada_workers", "Workers that live, by version.", "version", deployment.workers)
    oldest = "How long the oldest of them waits."
    yield _gauge(
        "tada_webhooks_waiting", "Deliveries that are not made yet.", figures.deliveries_waiting
    )
    yield _age("tada_webhooks_oldest_seconds", oldest, figures.oldest_delivery_at, figures.now)
    yield _gauge("tada_webhooks_disabled", "Webhooks that are disabled.", figures.webhooks_disabled)
    yield _gauge(
        "tada_blob_deletions_waiting",
        "Blobs that an erasure wants gone.",
        figures.deletions_waiting,
    )
    yield _age(
        "tada_blob_deletions_oldest_seconds", oldest, figures.oldest_deletion_at, figures.now
    )
    yield from _of_files(figures)
    yield from _of_backup(deployment, figures.now)


def _of_files(figures: Figures) -> Iterator[GaugeMetricFamily]:
    waiting = GaugeMetricFamily(
        "tada_files_waiting",
        "Exports and releases that are not made yet, by state.",
        labels=["kind", "state"],
    )
    for kind, files in figures.files.items():
        for state, count in files.states.items():
            waiting.add_metric([kind, state], count)
    yield waiting
    yield _by(
        "tada_files_oldest_seconds",
        "How long the oldest of them waits; a release that changes, since the erasure.",
        "kind",
        {
            kind: _seconds_since(files.oldest_at, figures.now)
            for kind, files in figures.files.items()
        },
    )
    description = (
        "Releases that an erasure wants changed, and that could not be: they are not served."
    )
    yield _gauge("tada_releases_stuck", description, figures.releases_stuck)


def _of_backup(deployment: Deployment, now: datetime) -> Iterator[GaugeMetricFamily]:
    """Yield the age also without a backup, since an alert on a missing series never fires."""
    backup = deployment.backup
    since, damaged = (
        (backup.made_at, backup.damaged) if backup is not None else (deployment.began_at, 0)
    )
    yield _age(
        "tada_backup_age_seconds",
        "Since the last `tada backup`; without one, since the first event.",
        since,
        now,
    )
    yield _gauge(
        "tada_backup_damaged_blobs",
        "Blobs that the last `tada backup` lacks: damaged or missing.",
        damaged,
    )


def _pools(database: Database) -> Iterator[GaugeMetricFamily]:
    """Yield the use of connection pools; SQLite has separate ones for reading and writing."""
    engines = {"write": database.write_engine, "read": database.read_engine}
    if not database.is_sqlite:
        engines = {"all": database.write_engine}
    pools = {
        name: engine.pool for name, engine in engines.items() if isinstance(engine.pool, QueuePool)
    }
    in_use = {name: pool.checkedout() for name, pool in pools.items()}
    most = dict.fromkeys(pools, database.limits.size + database.limits.overflow)
    yield _by("tada_database_connections_in_use", "This process's, at work.", "pool", in_use)
    yield _by("tada_database_connections_most", "This process's, at most.", "pool", most)


def _by(name: str, description: str, label: str, values: Mapping[str, float]) -> GaugeMetricFamily:
    """Return a family with one label. values: by the label's value."""
    family = GaugeMetricFamily(name, description, labels=[label])
    for label_value, value in values.items():
        family.add_metric([label_value], value)
    return family


def _gauge(name: str, description: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, description, value=float(value))


def _age(name: str, description: str, since: datetime | None, now: datetime) -> GaugeMetricFamily:
    """Return a gauge of seconds since then; 0 if nothing waits."""
    return _gauge(name, description, _seconds_since(since, now))


def _seconds_since(since: datetime | None, now: datetime) -> float:
    return max((now - since).total_seconds(), 0.0) if since is not None else 0.0
