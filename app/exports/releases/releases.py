"""Releases: requested by an owner; listed, downloaded and checked by everybody with access to the study.

A release is made by the same process as exports (file_runner.py). It is never deleted, and its name is never reused.
"""

import hashlib
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError, UnavailableError
from app.db.session import Database
from app.exports.release_models import Release
from app.exports.releases import queries as releases
from app.exports.releases.manifest import checksum_of
from app.exports.releases.queries import ReleaseRow
from app.exports.releases.release_filters import ReleaseFilters
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of, require_order
from app.http.ranges import StoredFile
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.studies import enter_study
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore

CHANGING_RETRY_SECONDS = 10


@dataclass(frozen=True, slots=True)
class CheckedFile:
    """A file of a release compared with the store. sha256: as frozen."""

    name: str
    blob_key: str
    sha256: str
    state: Literal["whole", "damaged", "missing"]


@dataclass(frozen=True, slots=True)
class CheckedRelease:
    """A release's files compared with the store. checksum: of the store's files, None if some are missing."""

    release: Release
    files: list[CheckedFile]
    checksum: str | None

    @property
    def is_whole(self) -> bool:
        """Whether every file is as it was frozen, and the checksum matches."""
        return self.checksum == self.release.checksum and all(
            file.state == "whole" for file in self.files
        )


def request_release(
    database: Database,
    caller: StaffCaller,
    study_code: str,
    *,
    name: str,
    note: str,
    filters: ReleaseFilters,
) -> ReleaseRow:
    """Request a release of the study's data, which a worker makes.

    Raises NotFoundError, InvalidInputError (`days_reversed`), ConflictError (`release_exists`, `sandbox_study`). A
    name whose release was never made may be used again.
    """
    require_order(filters.first_day, filters.last_day)
    taken = ConflictError(
        f"The study has a release {name!r}, or is making it.", code="release_exists"
    )
    now = datetime.now(UTC)
    try:
        with database.write() as session:
            study = enter_study(session, caller, study_code)
            if study.is_sandbox:
                raise ConflictError(
                    "A sandbox study has no releases: its data are for trying apps.",
                    code="sandbox_study",
                )
            existing = releases.find_release(session, study.id, name, lock=True)
            if existing is not None and (
                existing.release.state != "failed" or existing.release.checksum is not None
            ):
                raise taken
            if existing is not None:
                session.delete(existing.release)
                session.flush()
            release = Release(
                id=uuid.uuid4(),
                study_id=study.id,
                staff_id=caller.staff_id,
                name=name,
                note=note,
                filters=filters.as_json(),
                state="queued",
                attempts=0,
                rows_written=0,
                bytes=0,
                requested_at=now,
                former_checksums=[],
            )
            session.add(release)
            session.flush()
            audit.note(
                session,
                caller,
                "release.request",
                study_id=study.id,
                subject=name,
                filters=filters.as_json(),
            )
    except IntegrityError:  # the same name at the same moment
        raise taken from None
    return ReleaseRow(release, caller.name, [])


def list_releases(
    database: Database, caller: StaffCaller, study_code: str, *, cursor: str | None, limit: int
) -> Page[ReleaseRow]:
    """Return a study's releases, newest first. Raises NotFoundError, InvalidInputError for a cursor of another list."""
    listed = f"releases of {study_code}"
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = releases.page_of_releases(session, study.id, after=after, limit=limit + 1)
    return page_of(listed, rows, limit, lambda row: (row.release.requested_at, row.release.id))


def read_release(database: Database, caller: StaffCaller, study_code: str, name: str) -> ReleaseRow:
    """Return a release. Raises NotFoundError."""
    with database.read() as session:
        return _find(session, caller, study_code, name)


def open_release_file(
    database: Database, caller: StaffCaller, study_code: str, name: str, file: str
) -> StoredFile:
    """Return a file of a release and record the download in the audit log.

    Raises NotFoundError, ConflictError (`release_not_ready`, `release_failed`), UnavailableError (`release_changing`).
    """
    with database.write() as session:
        release, _, files = _find(session, caller, study_code, name)
        _require_ready(release)
        frozen = next((frozen for frozen in files if frozen.name == file), None)
        if frozen is None:
            raise NotFoundError("The release has no such file.")
        audit.note(
            session,
            caller,
            "release.download",
            study_id=release.study_id,
            subject=name,
            file=frozen.name,
        )
        return StoredFile(
            name=frozen.name, length=frozen.bytes, sha256=frozen.sha256, blob_key=frozen.blob_key
        )


def check_release(
    database: Database, blobs: BlobStore, caller: StaffCaller, study_code: str, name: str
) -> CheckedRelease:
    """Read all files of a release back. Raises as open_release_file, and OSError if the store is unavailable."""
    row = read_release(database, caller, study_code, name)
    _require_ready(row.release)
    return check_files(blobs, row)


def check_files(blobs: BlobStore, row: ReleaseRow) -> CheckedRelease:
    """Read all files back and compare them with what was frozen."""
    checked, sha256s = [], dict[str, str]()
    for file in row.files:
        sha256 = _sha256_of(blobs, file.blob_key)
        if sha256 is None:
            checked.append(CheckedFile(file.name, file.blob_key, file.sha256, "missing"))
            continue
        sha256s[file.name] = sha256
        is_whole = sha256 == file.sha256
        checked.append(
            CheckedFile(file.name, file.blob_key, file.sha256, "whole" if is_whole else "damaged")
        )
    is_complete = bool(row.files) and len(sha256s) == len(row.files)
    return CheckedRelease(row.release, checked, checksum_of(sha256s) if is_complete else None)


def _sha256_of(blobs: BlobStore, key: str) -> str | None:
    digest = hashlib.sha256()
    try:
        for piece in blobs.stream(key):
            digest.update(piece)
    except BlobMissingError:
        return None
    except BlobDamagedError:
        return ""
    return digest.hexdigest()


def _find(session: Session, caller: StaffCaller, study_code: str, name: str) -> ReleaseRow:
    study = enter_study(session, caller, study_code)
    row = releases.find_release(session, study.id, name)
    if row is None:
        raise NotFoundError("There is no such release in this study.")
    return row


def _require_ready(release: Release) -> None:
    match release.state:
        case "queued" | "running":
            raise ConflictError(
                "The release is not ready yet: try again later.", code="release_not_ready"
            )
        case "failed":
            raise ConflictError(
                "The release could not be made; its `failure` says why.", code="release_failed"
            )
        case "changing":
            raise UnavailableError(
                "Something in the release was erased: its files are being rewritten without it.",
                code="release_changing",
                retry_after_seconds=CHANGING_RETRY_SECONDS,
            )
