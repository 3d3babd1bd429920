"""Makes one file that waits for it: claims it, writes it of one moment, seals it, and says so in the database.

Run in a process beside the worker (app/file_worker.py). Whatever happens in between, nobody is served half a file, or
one with rows that were erased while it was written: it counts only by the last transaction, which asks whether the
claim is still ours and whether the study has erased anything since the snapshot. Broken off, the file is made again
from its beginning, of the moment of then.
"""

import errno
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
from app.exports.export_size import estimate_rows
from app.exports.export_spec import spec_of_json
from app.exports.file_work_queries import Work
from app.exports.made_file import Attempt, ClaimLostError, WorkLife, long_snapshot
from app.exports.models import Export
from app.exports.release_models import Release
from app.exports.tables.export_tables import write_export
from app.people.access.caller import StaffCaller
from app.people.access.secret_box import SecretBox
from app.people.models import Staff
from app.releases import queries as releases
from app.releases.release_runner import FilesLostError, make_release
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

MOST_ATTEMPTS = 5
FIRST_WAIT_SECONDS, LONGEST_WAIT_SECONDS = 5.0, 300.0
DONE, AGAIN, LOST = "done", "again", "lost"
CHANGING = "changing"  # of a release: it is tried until it is done
MOST_TRIES_WITHOUT_FILES = 870  # of such a one whose files are lost: three days, in which they can be put back
INTERNAL_ERROR = "internal_error"


@dataclass(frozen=True, slots=True)
class Ended:
    """What became of a try. outcome: done, again (later), lost (called off, taken over), or the code of a failure."""

    kind: str
    work_id: uuid.UUID
    outcome: str


class FileRunner:
    """One try of one file. claim: drawn for it. beat_seconds: shorter in tests."""

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        settings: Settings,
        box: SecretBox,
        claim: uuid.UUID,
        *,
        lease_seconds: float = file_work.LEASE_SECONDS,
        beat_seconds: float = 1.0,
    ) -> None:
        self._database, self._blobs, self._settings, self._claim = database, blobs, settings, claim
        self._box = box
        self._lease_seconds, self._beat_seconds = lease_seconds, beat_seconds

    def run_one(self) -> Ended | None:
        """Make what waits longest; None: nothing waits. Raises what keeps the database from being told."""
        with self._database.write() as session:
            work = file_work.claim_next(session, self._claim, self._lease_seconds)
        if work is None:
            return None
        died_each_time = work.attempts > MOST_ATTEMPTS and work.state != CHANGING
        outcome = self._tell(work, code="export_gave_up") if died_each_time else self._try(work)
        return Ended(work.__tablename__, work.id, outcome)

    def _try(self, work: Work) -> str:
        try:
            with WorkLife(self._database, work, self._claim, self._beat_seconds) as life:
                parts = self._database, self._blobs, self._settings
                if isinstance(work, Export):
                    with Attempt(*parts, work, self._claim, life) as attempt:
                        return DONE if self._make_export(attempt) else AGAIN
                with Attempt(*parts, work, self._claim, life) as making:
                    return DONE if make_release(making, self._box) else AGAIN
        except ClaimLostError:
            return LOST
        except Exception as error:  # the worker's edge: the work's row tells it
            log.warning("file_not_made", file=str(work.id), attempt=work.attempts, exc_info=error)
            is_over = work.state != CHANGING or (
                isinstance(error, FilesLostError) and work.attempts >= MOST_TRIES_WITHOUT_FILES
            )
            return self._tell(work, _lasting_code(error, work.attempts), is_over=is_over)

    def _make_export(self, attempt: Attempt[Export]) -> bool:
        export, life, spec = attempt.work, attempt.life, spec_of_json(attempt.work.spec)
        with attempt.new_file() as file:
            with long_snapshot(self._database) as session:
                moment = exports.moment_of(session, export.study_id)
                self._estimate(export, estimate_rows(session, export.study_id, spec))
                file.write_all(write_export(session, _acting_for(session, export), spec, counted=life.count_rows))
            key = attempt.seal(file)

        def end(_: Session, held: Export) -> None:
            held.state, held.blob_key, held.sha256 = "done", key, file.sha256
            held.rows_written, held.bytes, held.at_change_seq = life.rows, file.length, moment.change_seq
            held.finished_at = datetime.now(UTC)
            held.expires_at = held.finished_at + timedelta(days=self._settings.export_days)

        return attempt.finish(lambda session: exports.erasures_since(session, export.study_id, moment) == 0, end)

    def _estimate(self, work: Work, rows: int | None) -> None:
        if rows is not None:
            with self._database.write() as session:
                file_work.estimate(session, work, self._claim, rows)

    def _tell(self, work: Work, code: str | None, *, is_over: bool = True) -> str:
        """Note a failure for good; or that it is to be begun again after a while, and why it failed, if that lasts."""
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
    """Who asked for it, with what anybody needs who may fetch it: a viewer's eyes, in this study alone."""
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
    """Twice as long after each try. There is no end to tries: the power has one, or it is too large for a float."""
    return min(FIRST_WAIT_SECONDS * 2.0 ** min(attempts - 1, 10), LONGEST_WAIT_SECONDS)


def _lasting_code(error: Exception, attempts: int) -> str | None:
    """The code by which the work fails; None: it is tried again."""
    if isinstance(error, StorageFullError):
        return error.code
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StorageFullError.code
    if isinstance(error, TadaError) and not error.retryable:
        return error.code
    return INTERNAL_ERROR if attempts >= MOST_ATTEMPTS else None
