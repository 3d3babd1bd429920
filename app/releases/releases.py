"""Releases as a study's people see them: asked for by an owner, listed, fetched and checked by whoever sees the study.

A release is made by the same process as exports (file_runner.py). Its name is its own for ever; it is never deleted.
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
from app.http.paging import ID, INSTANT, Page, decode_cursor, page_of, require_order
from app.http.stored_file import StoredFile
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.studies import enter_study
from app.releases import queries as releases
from app.releases.freeze_release import ReleaseFilters
from app.releases.queries import NamedRelease
from app.releases.release_files import checksum_of
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore

CHANGING_RETRY_SECONDS = 10


@dataclass(frozen=True, slots=True)
class CheckedFile:
    """A file of a release as the store has it."""

    name: str
    blob_key: str
    sha256: str
    found: Literal["whole", "damaged", "missing"]


@dataclass(frozen=True, slots=True)
class CheckedRelease:
    """Whether a release's files are those that were frozen. checksum: of what the store has, None where files lack."""

    release: Release
    files: list[CheckedFile]
    checksum: str | None

    @property
    def is_whole(self) -> bool:
        """Every file is there as it was frozen, and they come to the checksum."""
        return self.checksum == self.release.checksum and all(file.found == "whole" for file in self.files)


def request_release(
    database: Database, caller: StaffCaller, study_code: str, *, name: str, note: str, filters: ReleaseFilters
) -> NamedRelease:
    """Freeze the study's data under a name: a worker does it soon.

    Raises NotFoundError, InvalidInputError (`days_reversed`), ConflictError (`release_exists`). A name whose release
    failed was never anybody's: it may be asked for again.
    """
    first_day, last_day = filters.first_day, filters.last_day
    require_order(first_day, last_day)
    taken = ConflictError(f"The study has a release {name!r}, or is making it.", code="release_exists")
    now = datetime.now(UTC)
    try:
        with database.write() as session:
            study = enter_study(session, caller, study_code)
            there = releases.find_release(session, study.id, name, lock=True)
            if there is not None and (there.release.state != "failed" or there.release.checksum is not None):
                raise taken
            if there is not None:
                session.delete(there.release)
                session.flush()
            release = Release(
                id=uuid.uuid4(),
                study_id=study.id,
                staff_id=caller.staff_id,
                name=name,
                note=note,
                filters=filters.told(),
                state="queued",
                attempts=0,
                rows_written=0,
                bytes=0,
                requested_at=now,
                former_checksums=[],
            )
            session.add(release)
            session.flush()
            audit.note(session, caller, "release.request", study_id=study.id, subject=name, filters=filters.told())
    except IntegrityError:  # the same name at the same moment
        raise taken from None
    return NamedRelease(release, caller.name, [])


def list_releases(
    database: Database, caller: StaffCaller, study_code: str, *, cursor: str | None, limit: int
) -> Page[NamedRelease]:
    """A study's releases, the newest first. Raises NotFoundError, InvalidInputError for a cursor of another list."""
    listed = f"releases of {study_code}"
    after = decode_cursor(listed, cursor, INSTANT, ID)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = releases.page_of_releases(session, study.id, after=after, limit=limit + 1)
    return page_of(listed, rows, limit, lambda row: (row.release.requested_at, row.release.id))


def read_release(database: Database, caller: StaffCaller, study_code: str, name: str) -> NamedRelease:
    """One release. Raises NotFoundError."""
    with database.read() as session:
        return _find(session, caller, study_code, name)


def open_release_file(database: Database, caller: StaffCaller, study_code: str, name: str, file: str) -> StoredFile:
    """A file, its fetching noted.

    Raises NotFoundError, ConflictError (`release_not_ready`, `release_failed`), UnavailableError (`release_changing`).
    """
    with database.write() as session:
        found = _find(session, caller, study_code, name)
        _require_ready(found.release)
        chosen = next((one for one in found.files if one.name == file), None)
        if chosen is None:
            raise NotFoundError("The release has no such file.")
        audit.note(session, caller, "release.download", study_id=found.release.study_id, subject=name, file=chosen.name)
        return StoredFile(name=chosen.name, length=chosen.bytes, sha256=chosen.sha256, blob_key=chosen.blob_key)


def check_release(
    database: Database, blobs: BlobStore, caller: StaffCaller, study_code: str, name: str
) -> CheckedRelease:
    """Read every file of a release back. Raises as open_release_file, and OSError of a store that is away."""
    found = read_release(database, caller, study_code, name)
    _require_ready(found.release)
    return check_files(blobs, found)


def check_files(blobs: BlobStore, found: NamedRelease) -> CheckedRelease:
    """Read every file back and compare."""
    checked, sha256s = [], dict[str, str]()
    for file in found.files:
        sha256 = _sha256_of(blobs, file.blob_key)
        if sha256 is None:
            checked.append(CheckedFile(file.name, file.blob_key, file.sha256, "missing"))
            continue
        sha256s[file.name] = sha256
        is_whole = sha256 == file.sha256
        checked.append(CheckedFile(file.name, file.blob_key, file.sha256, "whole" if is_whole else "damaged"))
    is_all = bool(found.files) and len(sha256s) == len(found.files)
    return CheckedRelease(found.release, checked, checksum_of(sha256s) if is_all else None)


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


def _find(session: Session, caller: StaffCaller, study_code: str, name: str) -> NamedRelease:
    study = enter_study(session, caller, study_code)
    found = releases.find_release(session, study.id, name)
    if found is None:
        raise NotFoundError("There is no such release in this study.")
    return found


def _require_ready(release: Release) -> None:
    match release.state:
        case "queued" | "running":
            raise ConflictError("The release is not made yet: ask again later.", code="release_not_ready")
        case "failed":
            raise ConflictError("The release could not be made; it tells why.", code="release_failed")
        case "changing":
            raise UnavailableError(
                "Something in the release was erased: its files are being written without it.",
                code="release_changing",
                retry_after_seconds=CHANGING_RETRY_SECONDS,
            )
