"""Makes one waiting export or release: claims it, writes its files from one snapshot, seals them, commits them.

A process of its own reads the rows (exports/file_task.py). A partial file, or one with rows that were erased while it
was written, is never served: the files count only with the last transaction, which checks that the claim still holds
and that the study has erased nothing since. An interrupted file is made again.
"""

import errno
import threading
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import structlog
from sqlalchemy.orm import Session

from app.core.errors import StorageFullError, TadaError
from app.core.settings import Settings
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.exports.export_file import request_of
from app.exports.export_size import estimate_rows
from app.exports.export_spec import spec_of_json
from app.exports.file_work_queries import Work
from app.exports.made_file import AskedToStopError, Attempt, ClaimLostError, WorkLife
from app.exports.models import Export
from app.exports.release_models import Release
from app.exports.releases import queries as releases
from app.exports.releases.release_runner import FilesLostError, make_release
from app.people.access.caller import StaffCaller
from app.people.access.secret_box import SecretBox
from app.people.models import Staff
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

MOST_ATTEMPTS = 5
FIRST_WAIT_SECONDS, LONGEST_WAIT_SECONDS = 5.0, 300.0
DONE, AGAIN, LOST = "done", "again", "lost"
CHANGING = "changing"  # state of a release that is retried until it succeeds
INTERNAL_ERROR = "internal_error"


@dataclass(frozen=True, slots=True)
class Ended:
    """The result of an attempt. outcome: done, again (later), lost (cancelled, taken over), or a failure's code."""

    kind: str
    work_id: uuid.UUID
    outcome: str


class FileRunner:
    """One attempt at one export or release.

    claim: random id.
    stopping: once it is set, the attempt is given up and does not count.
    beat_seconds: shorter in tests.
    """

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        settings: Settings,
        box: SecretBox,
        claim: uuid.UUID,
        *,
        stopping: threading.Event | None = None,
        lease_seconds: float = file_work.LEASE_SECONDS,
        beat_seconds: float = 1.0,
    ) -> None:
        self._database, self._blobs, self._settings, self._claim = database, blobs, settings, claim
        self._box, self._stopping = box, stopping or threading.Event()
        self._lease_seconds, self._beat_seconds = lease_seconds, beat_seconds

    def run_one(self) -> Ended | None:
        """Make the work that has waited longest; None if nothing waits. Raises if the outcome cannot be saved."""
        with self._database.write() as session:
            work = file_work.claim_next(session, self._claim, self._lease_seconds)
        if work is None:
            return None
        died_each_time = work.attempts > MOST_ATTEMPTS and work.state != CHANGING
        outcome = (
            self._save_failure(work, code="export_gave_up") if died_each_time else self._try(work)
        )
        return Ended(work.__tablename__, work.id, outcome)

    def _try(self, work: Work) -> str:
        try:
            with WorkLife(self._database, work, self._claim, self._beat_seconds) as life:
                parts = self._database, self._blobs, self._settings
                if isinstance(work, Export):
                    with Attempt(*parts, work, self._claim, life, self._stopping) as attempt:
                        return DONE if self._make_export(attempt) else AGAIN
                with Attempt(*parts, work, self._claim, life, self._stopping) as making:
                    return DONE if make_release(making, self._box) else AGAIN
        except ClaimLostError:
            return LOST
        except AskedToStopError:
            with self._database.write() as session:
                file_work.put_back(session, self._claim, counts=False)
            return AGAIN
        except Exception as error:  # the worker's edge: the failure is saved in the work's row
            log.warning("file_not_made", file=str(work.id), attempt=work.attempts, exc_info=error)
            is_over = work.state != CHANGING or isinstance(error, FilesLostError)
            return self._save_failure(work, _lasting_code(error, work.attempts), is_over=is_over)

    def _make_export(self, attempt: Attempt[Export]) -> bool:
        export, spec = attempt.work, spec_of_json(attempt.work.spec)
        with self._database.read() as session:
            moment = exports.moment_of(session, export.study_id)
            rows = estimate_rows(session, export.study_id, spec)
            caller = _acting_for(session, export)
        self._save_estimate(export, rows)
        with attempt.folder() as folder:
            path = folder / spec.file_name
            request = request_of(self._database, caller, spec, path)
            answer = attempt.run("export", request, folder)
            file = attempt.seal(path)

        def end(_: Session, held: Export) -> None:
            held.state, held.blob_key, held.sha256 = "done", file.key, file.sha256
            held.rows_written, held.bytes = int(str(answer["rows"])), file.length
            held.at_change_seq = moment.change_seq
            held.finished_at = datetime.now(UTC)
            held.expires_at = held.finished_at + timedelta(days=self._settings.export_days)

        return attempt.finish(
            lambda session: exports.erasures_since(session, export.study_id, moment) == 0, end
        )

    def _save_estimate(self, work: Work, rows: int | None) -> None:
        if rows is not None:
            with self._database.write() as session:
                file_work.save_estimate(session, work, self._claim, rows)

    def _save_failure(self, work: Work, code: str | None, *, is_over: bool = True) -> str:
        """Save a lasting failure, or schedule another attempt; return the outcome. code: None for a transient fault."""
        with self._database.write() as session:
            held = file_work.hold(session, work, self._claim)
            if held is None:
                return LOST
            if code is None or not is_over:
                file_work.begin_again(held, counts=True, after_seconds=_wait_seconds(held.attempts))
                held.failure_code = code or held.failure_code
                return AGAIN
            held.state, held.failure_code, held.finished_at = "failed", code, datetime.now(UTC)
            held.claim = held.heartbeat_at = None
            if isinstance(held, Release):
                releases.drop_files(session, held, held.finished_at)
            return code


def _acting_for(session: Session, export: Export) -> StaffCaller:
    """Return the person who requested it, as a viewer of this study: everybody in the study may download the file."""
    return StaffCaller(
        staff_id=export.staff_id,
        name=session.get_one(Staff, export.staff_id).name,
        is_admin=False,
        token_id=export.staff_id,
        roles={export.study_id: "viewer"},
        can_write=False,
        only_study_id=export.study_id,
    )


def _wait_seconds(attempts: int) -> float:
    """Return the wait before the next attempt, doubled each time; the exponent is bounded, as attempts are not."""
    return min(FIRST_WAIT_SECONDS * 2.0 ** min(attempts - 1, 10), LONGEST_WAIT_SECONDS)


def _lasting_code(error: Exception, attempts: int) -> str | None:
    """Return the code with which the work fails; None if it is tried again."""
    if isinstance(error, StorageFullError):
        return error.code
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StorageFullError.code
    if isinstance(error, TadaError) and not error.retryable:
        return error.code
    return INTERNAL_ERROR if attempts >= MOST_ATTEMPTS else None
