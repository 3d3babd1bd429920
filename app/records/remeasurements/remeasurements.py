"""Remeasurements: started, stopped and continued by an owner of the study or an operator; read by whoever may read it.

A study has at most one that is running. The same request again is the same remeasurement: it is
continued if it was stopped. Runs saved before stay saved; a stop gives the pairs in progress back,
to be measured after all.
"""

import uuid
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import structlog
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, GoneError, NotFoundError
from app.db.session import Database, despite_deadlocks
from app.http.paging import ID, INSTANT, TEXT, WHOLE_NUMBER, Page, decode_cursor, page_of
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.job_models import RemeasuredPair, Remeasurement
from app.meals.stored.models import Meal
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.models import Study
from app.people.participants import require_in_study
from app.people.studies import enter_study, load_study
from app.records.remeasurements import queries as remeasurements
from app.records.remeasurements.queries import PlannedPair, plan, skip_reason
from app.records.remeasurements.schemas import (
    ComparedItemOut,
    RemeasurementOut,
    RemeasurementPlanOut,
    Selection,
)
from app.vision.version import PIPELINE_VERSION


@dataclass(frozen=True, slots=True)
class Requester:
    """Who asks. caller None: an operator at the command line, who may enter every study."""

    name: str
    caller: StaffCaller | None = None

    def enter(self, session: Session, study_code: str, *, lock: bool = False) -> Study:
        """Return the study. lock: keep others from starting a remeasurement in it until commit.

        Raises NotFoundError, NotAllowedError.
        """
        if self.caller is not None:
            enter_study(session, self.caller, study_code)
        return load_study(session, study_code, lock=lock)


def plan_remeasurement(
    database: Database, requester: Requester, study_code: str, selection: Selection
) -> list[PlannedPair]:
    """Return which pairs would be measured again, and why others not. Changes nothing.

    Raises NotFoundError.
    """
    with database.read() as session:
        return plan(session, requester.enter(session, study_code).id, selection)


def count_plan(pairs: Sequence[PlannedPair]) -> RemeasurementPlanOut:
    """Return the numbers of a plan."""
    skipped = Counter(pair.skip for pair in pairs if pair.skip is not None)
    return RemeasurementPlanOut(
        pairs=len(pairs),
        would_measure=len(pairs) - skipped.total(),
        would_skip=dict(sorted(skipped.items())),
    )


def start_remeasurement(
    database: Database, requester: Requester, study_code: str, selection: Selection
) -> tuple[RemeasurementOut, bool]:
    """Start a remeasurement, or continue the unfinished one of the same selection.

    Returns whether it is a new one.

    Raises NotFoundError, ConflictError (`remeasurement_running`: another one of the study).
    """
    with database.write() as session:
        study = requester.enter(session, study_code, lock=True)
        unfinished = remeasurements.unfinished_of_study(session, study.id)
        for remeasurement in unfinished:
            if remeasurement.state == "running" and remeasurement.selection != selection.digest:
                raise _other_running(remeasurement)
            if remeasurement.selection == selection.digest:
                _continue(session, requester, remeasurement)
                return _view(session, remeasurement), False
        remeasurement = Remeasurement(
            id=uuid.uuid4(),
            study_id=study.id,
            author=requester.name,
            selection=selection.digest,
            state="running",
            pipeline_version=PIPELINE_VERSION,
            created_at=datetime.now(UTC),
        )
        session.add(remeasurement)
        session.flush()
        remeasurements.insert_pairs(session, remeasurement, selection)
        view = _view(session, remeasurement)
        _note(session, requester, remeasurement, "start", pairs=view.pairs)
        return view, True


def stop_remeasurement(
    database: Database, requester: Requester, study_code: str, remeasurement_id: uuid.UUID
) -> RemeasurementOut:
    """Stop a remeasurement; repeated, it changes nothing.

    Raises NotFoundError, ConflictError (`remeasurement_done`).
    """

    def stop() -> RemeasurementOut:
        with database.write() as session:
            remeasurement = _find(session, requester, study_code, remeasurement_id, lock=True)
            _require_unfinished(remeasurement)
            if remeasurement.state == "running":
                remeasurement.state, remeasurement.ended_at = "stopped", datetime.now(UTC)
                _give_back(session, remeasurement.id)
                _note(session, requester, remeasurement, "stop")
            return _view(session, remeasurement)

    return despite_deadlocks(stop)


def continue_remeasurement(
    database: Database, requester: Requester, study_code: str, remeasurement_id: uuid.UUID
) -> RemeasurementOut:
    """Continue a stopped remeasurement; repeated, it changes nothing.

    Raises NotFoundError, ConflictError (`remeasurement_done`, `remeasurement_running`: another one
    of the study).
    """
    with database.write() as session:
        remeasurement = _find(session, requester, study_code, remeasurement_id, lock=True)
        _require_unfinished(remeasurement)
        for other in remeasurements.unfinished_of_study(session, remeasurement.study_id):
            if other.state == "running" and other.id != remeasurement.id:
                raise _other_running(other)
        _continue(session, requester, remeasurement)
        return _view(session, remeasurement)


def read_remeasurement(
    database: Database, requester: Requester, study_code: str, remeasurement_id: uuid.UUID
) -> RemeasurementOut:
    """Return a remeasurement. Raises NotFoundError."""
    with database.read() as session:
        return _view(session, _find(session, requester, study_code, remeasurement_id))


def list_remeasurements(
    database: Database, requester: Requester, study_code: str, *, cursor: str | None, limit: int
) -> Page[RemeasurementOut]:
    """Return a study's remeasurements, the newest first.

    Raises NotFoundError, InvalidInputError.
    """
    listed = f"remeasurements of {study_code}"
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        study = requester.enter(session, study_code)
        rows = remeasurements.page_of_remeasurements(
            session, study.id, after=after, limit=limit + 1
        )
        views = remeasurements.progress_of(session, rows)
    return page_of(listed, views, limit, lambda view: (view.created_at, view.id))


def list_compared(
    database: Database,
    requester: Requester,
    study_code: str,
    remeasurement_id: uuid.UUID,
    *,
    cursor: str | None,
    limit: int,
) -> Page[ComparedItemOut]:
    """Return rows of the table of old and new volumes, by meal.

    Raises NotFoundError, InvalidInputError.
    """
    listed = f"items of remeasurement {remeasurement_id}"
    after = decode_cursor(listed, cursor, WHOLE_NUMBER, TEXT, ID)
    with database.read() as session:
        remeasurement = _find(session, requester, study_code, remeasurement_id)
        rows = remeasurements.page_of_rows(session, remeasurement.id, after=after, limit=limit + 1)
    page = page_of(listed, rows, limit, lambda row: row[0])
    return Page([row for _, row in page.rows], page.cursor)


def _find(
    session: Session,
    requester: Requester,
    study_code: str,
    remeasurement_id: uuid.UUID,
    *,
    lock: bool = False,
) -> Remeasurement:
    study = requester.enter(session, study_code, lock=lock)
    remeasurement = remeasurements.find_remeasurement(
        session, study.id, remeasurement_id, lock=lock
    )
    if remeasurement is None:
        raise NotFoundError("There is no such remeasurement in this study.")
    return remeasurement


def _view(session: Session, remeasurement: Remeasurement) -> RemeasurementOut:
    return remeasurements.progress_of(session, [remeasurement])[0]


def _continue(session: Session, requester: Requester, remeasurement: Remeasurement) -> None:
    if remeasurement.state == "stopped":
        remeasurement.state, remeasurement.ended_at = "running", None
        _note(session, requester, remeasurement, "continue")


def _give_back(session: Session, remeasurement_id: uuid.UUID) -> None:
    """End the jobs in progress without a result; their pairs are pending again."""
    for pair in remeasurements.open_pairs(session, remeasurement_id, "queued"):
        live = jobs.lock_live_job(session, pair.job_id) if pair.job_id is not None else None
        if live is not None:
            jobs.drop_job(live[0], datetime.now(UTC))
            remeasurements.reopen_pair(session, live[0].id)


def _note(
    session: Session,
    requester: Requester,
    remeasurement: Remeasurement,
    deed: str,
    **details: object,
) -> None:
    audit.note(
        session,
        requester.caller,
        f"remeasurement.{deed}",
        study_id=remeasurement.study_id,
        subject=remeasurement.id,
        **details,
    )


def _require_unfinished(remeasurement: Remeasurement) -> None:
    if remeasurement.state == "done":
        raise ConflictError(
            "The remeasurement is done: start another one.", code="remeasurement_done"
        )


def _other_running(other: Remeasurement) -> ConflictError:
    return ConflictError(
        "Another remeasurement of this study is running: stop it, or wait until it is done.",
        code="remeasurement_running",
        remeasurement=str(other.id),
    )


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
