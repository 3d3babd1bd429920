"""Freezing a release, or rewriting it without erased data, in the side process.

As for exports, only the last transaction counts (file_runner.py): the claim must still hold; for a new release nothing
may have been erased since the snapshot; for a changed one no further removal may be pending. A change is retried until
it succeeds, and the release is not served until then. Only undamaged files are rewritten: a damaged one would give
wrong figures under a valid checksum.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from pydantic import JsonValue
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
from app.releases.release_files import MANIFEST, FormerChecksum, Manifest, ReleaseFiles
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore

PROTOCOL = (  # parts of a study's protocol that explain the data
    *("code", "name", "marker", "expects_after_pair", "after_window_minutes", "location_policy", "location_decimals"),
    *("withdrawal_policy", "retention_days", "gives_feedback", "day_starts_minutes", "version"),
)


class FilesLostError(TadaError):
    """A file of a release is missing or damaged in the store: the release cannot be changed until it is restored."""

    code = "release_files_missing"


def make_release(attempt: Attempt[Release], box: SecretBox) -> bool:
    """Freeze a release, or rewrite it without erased data.

    Returns whether it is ready; False if it has to begin again. Raises ClaimLostError, FilesLostError and others.
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
        facts = {
            "study": study.code,
            "name": release.name,
            "note": release.note,
            "filters": release.filters,
            "protocol": {name: getattr(study, name) for name in PROTOCOL},
            "frozen_at": frozen_at.isoformat(),
            "frozen_by": session.get_one(Staff, release.staff_id).name,
            "change_seq": moment.change_seq,
            "program": app.__version__,
            "contents": contents.as_json(),
            "altered": [],
        }
    files.add_manifest(facts)

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
        fetch_file = _FrozenFiles(blobs, frozen, Path(folder))
        values: dict[str, JsonValue] = json.loads(fetch_file(MANIFEST).read_bytes())
        manifest = Manifest.model_validate(values)
        alteration = ReleaseAlteration(manifest, fetch_file, Verdicts(box, changes))
        is_affected, now = alteration.is_affected(), datetime.now(UTC)
        if is_affected:
            contents = alteration.write(files)
            facts = {name: value for name, value in values.items() if name not in ("format", "tables", "files")}
            former = [*manifest.altered, FormerChecksum(checksum=manifest.checksum, until=now.isoformat())]
            files.add_manifest(
                {**facts, "contents": contents.as_json(), "altered": [each.model_dump() for each in former]}
            )

    def end(session: Session, held: Release) -> None:
        releases.forget_changes(session, done)
        if not is_affected:
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
    """Replace the release's files and mark the former ones for deletion."""
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
    privacy.schedule_deletion(session, releases.replace_files(session, held.id, rows), datetime.now(UTC))
    held.checksum = files.checksum
    _become_ready(held, [(file.name, file.rows, file.bytes) for file in files.files.values()])


def _become_ready(held: Release, files: Sequence[tuple[str, int | None, int]]) -> None:
    """files: name, rows, bytes."""
    held.rows_written = sum(rows for name, rows, _ in files if name.endswith(".parquet") and rows is not None)
    held.bytes = sum(length for _, _, length in files)
    held.state, held.finished_at = "ready", datetime.now(UTC)
    held.begin_after = held.failure_code = None
    held.attempts = 0


class _FrozenFiles:
    """Fetches files of a release into a folder, each once, and compares them with their SHA-256."""

    def __init__(self, blobs: BlobStore, files: Mapping[str, ReleaseFile], folder: Path) -> None:
        self._blobs, self._files, self._folder = blobs, files, folder
        self._paths: dict[str, Path] = {}

    def __call__(self, name: str) -> Path:
        """Return the local file. Raises FilesLostError."""
        if name not in self._paths:
            self._paths[name] = self._fetch(name)
        return self._paths[name]

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
