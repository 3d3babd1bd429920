"""Exports in the background: requesting, listing, downloading, cancelling and removing them.

A worker makes the file (releases/file_runner.py). It shows the study as a viewer sees it, so everybody with access to
the study may see and download it; to others neither exists (access_rules.py). Only the person who requested an export,
or an owner, may cancel or remove it.
"""

import hashlib
import json
import uuid
from dataclasses import replace
from datetime import UTC, datetime

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import (
    ConflictError,
    GoneError,
    NotAllowedError,
    NotFoundError,
    RateLimitedError,
)
from app.db.session import Database
from app.exports import queries as exports
from app.exports.export_spec import ExportSpec, check_spec, spec_as_json, spec_of_json
from app.exports.models import UNDER_WAY, Export
from app.exports.queries import RequestedExport
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of
from app.http.ranges import StoredFile
from app.people import privacy_queries as privacy
from app.people.access import audit
from app.people.access.caller import StaffCaller, role_in
from app.people.studies import enter_study

MOST_OF_PERSON = 3  # unfinished in a study
MOST_OF_STUDY = 10
RETRY_AFTER_SECONDS = 60


def request_export(
    database: Database, caller: StaffCaller, study_code: str, spec: ExportSpec
) -> tuple[RequestedExport, bool]:
    """Request a file of the study, whatever study the spec's filters name. Returns it, and whether it is new.

    A person who repeats a request before the file is made gets the same export. Raises NotFoundError, InvalidInputError
    (`export_not_offered`, `days_reversed`), RateLimitedError (`too_many_exports`).
    """
    spec = replace(spec, filters=replace(spec.filters, study_code=study_code))
    check_spec(spec)
    spec_json = spec_as_json(spec)
    spec_sha256 = hashlib.sha256(json.dumps(spec_json, sort_keys=True).encode()).hexdigest()
    try:
        with database.write() as session:
            study = enter_study(session, caller, study_code)
            same = exports.same_under_way(session, study.id, caller.staff_id, spec_sha256)
            if same is not None:
                return RequestedExport(same, caller.name), False
            exports.lock_study(session, study.id)  # so that concurrent requests count each other
            _require_room(session, study.id, caller.staff_id)
            export = Export(
                id=uuid.uuid4(),
                study_id=study.id,
                staff_id=caller.staff_id,
                spec=spec_json,
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
    except IntegrityError:  # the same request at the same moment: the unique index admits one
        with database.read() as session:
            study = enter_study(session, caller, study_code)
            same = exports.same_under_way(session, study.id, caller.staff_id, spec_sha256)
        if same is None:
            raise
        return RequestedExport(same, caller.name), False
    return RequestedExport(export, caller.name), True


def list_exports(
    database: Database, caller: StaffCaller, study_code: str, *, cursor: str | None, limit: int
) -> Page[RequestedExport]:
    """Return a study's exports, newest first. Raises NotFoundError, InvalidInputError for a cursor of another list."""
    listed = f"exports of {study_code}"
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = exports.page_of_exports(session, study.id, after=after, limit=limit + 1)
    return page_of(listed, rows, limit, lambda row: (row.export.requested_at, row.export.id))


def read_export(
    database: Database, caller: StaffCaller, study_code: str, export_id: uuid.UUID
) -> RequestedExport:
    """Return an export. Raises NotFoundError."""
    with database.read() as session:
        return _find(session, caller, study_code, export_id)


def open_export(
    database: Database, caller: StaffCaller, study_code: str, export_id: uuid.UUID
) -> StoredFile:
    """Return an export's file and record the download in the audit log.

    Raises NotFoundError, ConflictError (`export_not_ready`, `export_failed`, `export_cancelled`), GoneError
    (`export_expired`).
    """
    with database.write() as session:
        export = _find(session, caller, study_code, export_id).export
        _require_done(export)
        if export.blob_key is None or export.sha256 is None:
            raise NotFoundError("There is no such export.")
        audit.note(
            session, caller, "export.download", study_id=export.study_id, subject=str(export.id)
        )
        return StoredFile(
            name=spec_of_json(export.spec).file_name,
            length=export.bytes,
            sha256=export.sha256,
            blob_key=export.blob_key,
        )


def remove_export(
    database: Database, caller: StaffCaller, study_code: str, export_id: uuid.UUID
) -> None:
    """Cancel an unfinished export; remove a finished one with its file. Raises NotFoundError, NotAllowedError."""
    with database.write() as session:
        export = _find(session, caller, study_code, export_id, lock=True).export
        if export.staff_id != caller.staff_id and role_in(caller, export.study_id) != "owner":
            raise NotAllowedError(
                "Only the person who requested the export, or an owner, can do this.",
                code="export_of_another",
            )
        now, was = datetime.now(UTC), export.state
        if was in UNDER_WAY:
            export.state, export.claim, export.finished_at = "cancelled", None, now
        else:
            if export.blob_key is not None:
                privacy.schedule_deletion(session, [export.blob_key], now)
            session.delete(export)
        audit.note(
            session,
            caller,
            "export.remove",
            study_id=export.study_id,
            subject=str(export.id),
            was=was,
        )


def _find(
    session: Session,
    caller: StaffCaller,
    study_code: str,
    export_id: uuid.UUID,
    *,
    lock: bool = False,
) -> RequestedExport:
    study = enter_study(session, caller, study_code)
    row = exports.find_export(session, study.id, export_id, lock=lock)
    if row is None:
        raise NotFoundError("There is no such export in this study.")
    return row


def _require_room(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID) -> None:
    own, all_of_study = exports.count_under_way(session, study_id, staff_id)
    for count, most, subject in (
        (own, MOST_OF_PERSON, "You have"),
        (all_of_study, MOST_OF_STUDY, "The study has"),
    ):
        if count >= most:
            raise RateLimitedError(
                f"{subject} {count} unfinished exports, which is the limit: wait for one, or cancel one.",
                code="too_many_exports",
                limit=most,
                retry_after_seconds=RETRY_AFTER_SECONDS,
            )


def _require_done(export: Export) -> None:
    match export.state:
        case "queued" | "running":
            raise ConflictError(
                "The file is not ready yet: try again later.", code="export_not_ready"
            )
        case "failed":
            raise ConflictError(
                "The file could not be made: request another export.", code="export_failed"
            )
        case "cancelled":
            raise ConflictError("The export was cancelled.", code="export_cancelled")
        case "expired":
            raise GoneError(
                "The file is gone: it expired, something in it was erased, or the study has stopped keeping places. "
                "Request another export.",
                code="export_expired",
            )
