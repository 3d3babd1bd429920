"""What a side process does for a release: freezes it, or writes it anew without what was erased.

As with exports it counts only by the last transaction (file_runner.py): there the claim must still be ours, and of a
release that is frozen nothing may have been erased since the moment; of one that is changed nothing more may wait to be
taken out. A change is tried until it is done, however often it fails: until then the release is not served. Only files
that are what was frozen are changed: a damaged one would give other figures under a checksum of their own.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from sqlalchemy.orm import Session

import app
from app.core.errors import TadaError
from app.exports import queries as exports
from app.exports.made_file import Attempt, long_snapshot
from app.exports.release_models import Release, ReleaseFile
from app.people import privacy_queries as privacy
from app.people.access import audit
from app.people.access.secret_box import SecretBox
from app.people.models import Staff, Study
from app.releases import queries as releases
from app.releases.alter_release import ReleaseAlteration, Verdicts
from app.releases.freeze_release import filters_of_json, freeze
from app.releases.release_files import MANIFEST, ReleaseFiles
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore

PROTOCOL = (  # what a study's protocol tells of how the data came about
    *("code", "name", "marker", "expects_after_pair", "after_window_minutes", "location_policy", "location_decimals"),
    *("withdrawal_policy", "retention_days", "gives_feedback", "day_starts_minutes", "version"),
)


class FilesLostError(TadaError):
    """A file of a release is not in the store, or not what was frozen: unless it is put back, nobody can change it."""

    code = "release_files_missing"


def make_release(attempt: Attempt[Release], box: SecretBox) -> bool:
    """Freeze a release, or write it anew without what was erased.

    Returns whether it is ready; False: it begins again. Raises ClaimLostError, FilesLostError, and what goes wrong.
    """
    files = ReleaseFiles(attempt.new_file, lambda name, file: attempt.seal(file, name), attempt.life.count_rows)
    return _alter(attempt, box, files) if attempt.work.state == "changing" else _freeze(attempt, files)


def _freeze(attempt: Attempt[Release], files: ReleaseFiles) -> bool:
    release = attempt.work
    with long_snapshot(attempt.database) as session:
        moment = exports.moment_of(session, release.study_id)
        study = session.get_one(Study, release.study_id)
        frozen_at = datetime.now(UTC)
        contents = freeze(session, study.id, study.code, filters_of_json(release.filters), files)
        told = {
            "study": study.code,
            "name": release.name,
            "note": release.note,
            "filters": release.filters,
            "protocol": {name: getattr(study, name) for name in PROTOCOL},
            "frozen_at": frozen_at.isoformat(),
            "frozen_by": session.get_one(Staff, release.staff_id).name,
            "change_seq": moment.change_seq,
            "program": app.__version__,
            "contents": contents.told(),
            "altered": [],
        }
    files.add_manifest(told)

    def end(session: Session, held: Release) -> None:
        held.frozen_at, held.at_change_seq = frozen_at, moment.change_seq
        _replace_files(session, held, files)
        audit.note(session, None, "release.freeze", study_id=held.study_id, subject=held.name, sha256=held.checksum)

    return attempt.finish(lambda session: exports.erasures_since(session, release.study_id, moment) == 0, end)


def _alter(attempt: Attempt[Release], box: SecretBox, files: ReleaseFiles) -> bool:
    release, blobs = attempt.work, attempt.blobs
    with attempt.database.read() as session:
        changes = releases.changes_of(session, release.id)
        frozen = {file.name: file for file in releases.files_of(session, release.id)}
    done = {change.id for change in changes}
    with TemporaryDirectory(prefix="made-", dir=blobs.staging_folder()) as folder:
        fetched = _Fetched(blobs, frozen, Path(folder))
        manifest = json.loads(fetched(MANIFEST).read_bytes())
        alteration = ReleaseAlteration(manifest, fetched, Verdicts(box, changes))
        is_met, now = alteration.is_met(), datetime.now(UTC)
        if is_met:
            contents = alteration.write(files)
            told = {name: manifest[name] for name in manifest if name not in ("format", "tables", "files")}
            former = [*manifest["altered"], {"checksum": manifest["checksum"], "until": now.isoformat()}]
            files.add_manifest(told | {"contents": contents.told(), "altered": former})

    def end(session: Session, held: Release) -> None:
        releases.forget_changes(session, done)
        if not is_met:
            _become_ready(held, [(file.name, file.rows, file.bytes) for file in frozen.values()])
            return
        held.former_checksums = [*held.former_checksums, [held.checksum, now.isoformat()]]
        held.altered_at = now
        _replace_files(session, held, files)
        audit.note(session, None, "release.alter", study_id=held.study_id, subject=held.name, sha256=held.checksum)

    def is_all(session: Session) -> bool:
        return {change.id for change in releases.changes_of(session, release.id)} == done

    return attempt.finish(is_all, end)


def _replace_files(session: Session, held: Release, files: ReleaseFiles) -> None:
    """The release has these files now, and those that it had are to go."""
    rows = [
        ReleaseFile(
            release_id=held.id,
            name=file.name,
            rows=file.rows,
            bytes=file.bytes,
            sha256=file.sha256,
            blob_key=file.place,
        )
        for file in files.files.values()
    ]
    privacy.want_deleted(session, releases.replace_files(session, held.id, rows), datetime.now(UTC))
    held.checksum = files.checksum
    _become_ready(held, [(file.name, file.rows, file.bytes) for file in files.files.values()])


def _become_ready(held: Release, files: Sequence[tuple[str, int | None, int]]) -> None:
    """files: name, rows, bytes."""
    held.rows_written = sum(rows for name, rows, _ in files if name.endswith(".parquet") and rows is not None)
    held.bytes = sum(length for _, _, length in files)
    held.state, held.finished_at = "ready", datetime.now(UTC)
    held.begin_after = held.failure_code = None
    held.attempts = 0


class _Fetched:
    """Files of a release as local files, each fetched once and compared with what was frozen."""

    def __init__(self, blobs: BlobStore, files: Mapping[str, ReleaseFile], folder: Path) -> None:
        self._blobs, self._files, self._folder = blobs, files, folder
        self._there: dict[str, Path] = {}

    def __call__(self, name: str) -> Path:
        """Raises FilesLostError."""
        if name not in self._there:
            self._there[name] = self._fetch(name)
        return self._there[name]

    def _fetch(self, name: str) -> Path:
        if name not in self._files:
            raise FilesLostError(f"The release has no file {name}.")
        frozen, path = self._files[name], self._folder / name
        damaged = FilesLostError(f"{frozen.blob_key} is not what was frozen.", code="release_files_damaged")
        try:
            self._blobs.fetch(frozen.blob_key, path)
        except BlobMissingError:
            raise FilesLostError(f"{frozen.blob_key} is not in the store.") from None
        except BlobDamagedError:
            raise damaged from None
        with path.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() != frozen.sha256:
                raise damaged
        return path
