"""Exports in the background as those who ask for them see them: asked for, listed, fetched, called off.

A worker makes the file (releases/file_runner.py). It is of the whole study, as a viewer sees it, so whoever may see the
study may see and fetch it; who may not hears of neither (access_rules.py). Called off or removed is it by who asked for
it, or by an owner.
"""

import hashlib
import json
import uuid
from dataclasses import replace
from datetime import UTC, datetime

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, GoneError, NotAllowedError, NotFoundError, RateLimitedError
from app.db.session import Database
from app.exports import queries as exports
from app.exports.export_spec import ExportSpec, check_spec, spec_as_json, spec_of_json
from app.exports.models import UNDER_WAY, Export
from app.exports.queries import AskedExport
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of
from app.http.stored_file import StoredFile
from app.people import privacy_queries as privacy
from app.people.access import audit
from app.people.access.caller import StaffCaller, role_in
from app.people.studies import enter_study

MOST_OF_PERSON = 3  # under way in a study
MOST_OF_STUDY = 10
RETRY_AFTER_SECONDS = 60


def request_export(
    database: Database, caller: StaffCaller, study_code: str, spec: ExportSpec
) -> tuple[AskedExport, bool]:
    """Ask for a file of the study, whatever study the spec's filters name. Returns it, and whether it is new.

    The same asked for by the same person while it is not made yet is the same export. Raises NotFoundError,
    InvalidInputError (`export_not_offered`, `days_reversed`), RateLimitedError (`too_many_exports`).
    """
    spec = replace(spec, filters=replace(spec.filters, study_code=study_code))
    check_spec(spec)
    told = spec_as_json(spec)
    spec_sha256 = hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()
    try:
        with database.write() as session:
            study = enter_study(session, caller, study_code)
            there = exports.same_under_way(session, study.id, caller.staff_id, spec_sha256)
            if there is not None:
                return AskedExport(there, caller.name), False
            exports.lock_study(session, study.id)  # so that two at once count each other
            _require_room(session, study.id, caller.staff_id)
            export = Export(
                id=uuid.uuid4(),
                study_id=study.id,
                staff_id=caller.staff_id,
                spec=told,
                spec_sha256=spec_sha256,
                state="queued",
                attempts=0,
                rows_written=0,
                bytes=0,
                requested_at=datetime.now(UTC),
            )
            session.add(export)
            session.flush()
            audit.note(
                session,
                caller,
                "export.request",
                study_id=study.id,
                subject=str(export.id),
                rows=spec.rows,
                layout=spec.layout,
                output=spec.output,
                components=spec.components,
                filters=[name for name in spec.filters.set_names if name != "study_code"],
            )
    except IntegrityError:  # the same at the same moment: the index lets one in
        with database.read() as session:
            study = enter_study(session, caller, study_code)
            there = exports.same_under_way(session, study.id, caller.staff_id, spec_sha256)
        if there is None:
            raise
        return AskedExport(there, caller.name), False
    return AskedExport(export, caller.name), True


def list_exports(
    database: Database, caller: StaffCaller, study_code: str, *, cursor: str | None, limit: int
) -> Page[AskedExport]:
    """A study's exports, the newest first. Raises NotFoundError, InvalidInputError for a cursor of another list."""
    listed = f"exports of {study_code}"
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = exports.page_of_exports(session, study.id, after=after, limit=limit + 1)
    return page_of(listed, rows, limit, lambda row: (row.export.requested_at, row.export.id))


def read_export(database: Database, caller: StaffCaller, study_code: str, export_id: uuid.UUID) -> AskedExport:
    """How far an export is. Raises NotFoundError."""
    with database.read() as session:
        return _find(session, caller, study_code, export_id)


def open_export(database: Database, caller: StaffCaller, study_code: str, export_id: uuid.UUID) -> StoredFile:
    """The file, its fetching noted.

    Raises NotFoundError, ConflictError (`export_not_ready`, `export_failed`, `export_cancelled`), GoneError
    (`export_expired`).
    """
    with database.write() as session:
        export = _find(session, caller, study_code, export_id).export
        _require_done(export)
        if export.blob_key is None or export.sha256 is None:
            raise NotFoundError("There is no such export.")
        audit.note(session, caller, "export.download", study_id=export.study_id, subject=str(export.id))
        spec = spec_of_json(export.spec)
        return StoredFile(
            name=f"{study_code}-{spec.rows}.{spec.output}",
            length=export.bytes,
            sha256=export.sha256,
            blob_key=export.blob_key,
        )


def remove_export(database: Database, caller: StaffCaller, study_code: str, export_id: uuid.UUID) -> None:
    """Call off what is not made yet; remove what has ended, with its file. Raises NotFoundError, NotAllowedError."""
    with database.write() as session:
        export = _find(session, caller, study_code, export_id, lock=True).export
        if export.staff_id != caller.staff_id and role_in(caller, export.study_id) != "owner":
            raise NotAllowedError("Only who asked for an export, or an owner, can do this.", code="export_of_another")
        now, was = datetime.now(UTC), export.state
        if was in UNDER_WAY:
            export.state, export.claim, export.finished_at = "cancelled", None, now
        else:
            if export.blob_key is not None:
                privacy.want_deleted(session, [export.blob_key], now)
            session.delete(export)
        audit.note(session, caller, "export.remove", study_id=export.study_id, subject=str(export.id), was=was)


def _find(
    session: Session, caller: StaffCaller, study_code: str, export_id: uuid.UUID, *, lock: bool = False
) -> AskedExport:
    study = enter_study(session, caller, study_code)
    found = exports.find_export(session, study.id, export_id, lock=lock)
    if found is None:
        raise NotFoundError("There is no such export in this study.")
    return found


def _require_room(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID) -> None:
    mine, every = exports.under_way(session, study_id, staff_id)
    for count, most, whose in (
        (mine, MOST_OF_PERSON, "You have"),
        (every, MOST_OF_STUDY, "The study has"),
    ):
        if count >= most:
            raise RateLimitedError(
                f"{whose} {count} exports that are not made yet, the limit: wait for one, or call one off.",
                code="too_many_exports",
                limit=most,
                retry_after_seconds=RETRY_AFTER_SECONDS,
            )


def _require_done(export: Export) -> None:
    match export.state:
        case "queued" | "running":
            raise ConflictError("The file is not made yet: ask again later.", code="export_not_ready")
        case "failed":
            raise ConflictError("The file could not be made: ask for another export.", code="export_failed")
        case "cancelled":
            raise ConflictError("The export was called off.", code="export_cancelled")
        case "expired":
            raise GoneError(
                "The file is gone: its time was over, something in it was erased, or the study has stopped keeping "
                "places. Ask for another export.",
                code="export_expired",
            )
