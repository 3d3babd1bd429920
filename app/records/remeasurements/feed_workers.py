"""Queue the next pairs of running remeasurements as background jobs, when a worker is idle (jobs/claims.py).

A pair's row names its job from the transaction that queues it, so a pair has one live job at most, whatever process
dies in between. Pairs that have nothing to measure are skipped on the way, with the reason of that moment.
"""

import uuid
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.core.errors import GoneError
from app.db.session import Database, despite_deadlocks
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.models import Meal
from app.meals.stored.remeasurement_models import RemeasuredPair, Remeasurement
from app.people.participants import require_in_study
from app.records.remeasurements import queries as remeasurements
from app.records.remeasurements.choose_pairs import skip_reason

log = structlog.get_logger()

MOST_LOOKED_AT = 100  # pairs of one transaction, most of which may have to be skipped


class FeedWorkers:
    """The backlog of a worker: called with the number of jobs that it has room for."""

    def __init__(self, database: Database, queue: JobQueue) -> None:
        self._database = database
        self._queue = queue

    def __call__(self, room: int) -> int:
        """Queue up to `room` background jobs. Returns their number."""
        with self._database.read() as session:
            running = remeasurements.running_ids(session)
        for remeasurement_id in running:
            queued = self._feed(remeasurement_id, room)
            if queued:
                return queued
        return 0

    def _feed(self, remeasurement_id: uuid.UUID, room: int) -> int:
        """Queue pairs of one remeasurement; skip those that cannot be measured until there is one or none is left."""
        while True:
            looked_at, queued = despite_deadlocks(lambda: self._feed_once(remeasurement_id, room))
            if queued or not looked_at:
                return queued

    def _feed_once(self, remeasurement_id: uuid.UUID, room: int) -> tuple[int, int]:
        """Return the numbers of pairs looked at and of jobs queued, in one transaction."""
        looked_at = queued = 0
        with self._database.write() as session:
            remeasurement = remeasurements.lock_running(session, remeasurement_id)
            if remeasurement is None:
                return 0, 0
            for pair in remeasurements.open_pairs(
                session, remeasurement_id, "pending", MOST_LOOKED_AT
            ):
                if queued == room:
                    break
                queued += self._queue_or_skip(session, pair)
                looked_at += 1
            if not looked_at and not remeasurements.open_pairs(
                session, remeasurement_id, "queued", 1
            ):
                _finish(remeasurement)
        return looked_at, queued

    def _queue_or_skip(self, session: Session, pair: RemeasuredPair) -> bool:
        meal = session.get_one(Meal, pair.meal_id)
        reason = skip_reason(
            meal,
            pair.pair,
            meals.images_of(session, meal.id),
            is_withdrawn=not _is_in_study(session, meal),
        )
        if reason is not None:
            pair.state, pair.reason, pair.ended_at = "skipped", reason, datetime.now(UTC)
            return False
        job = self._queue.enqueue_rerun(session, meal.id, pair.pair)
        pair.state, pair.job_id = "queued", job.id
        return True


def _is_in_study(session: Session, meal: Meal) -> bool:
    try:
        require_in_study(session, meal.participant_id)
    except GoneError:
        return False
    return True


def _finish(remeasurement: Remeasurement) -> None:
    remeasurement.state, remeasurement.ended_at = "done", datetime.now(UTC)
    log.info("remeasurement_done", remeasurement_id=str(remeasurement.id))
