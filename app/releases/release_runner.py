"""What a side process does for a release: freezes it, or writes it anew without what was erased.

As with exports it counts only by the last transaction (file_runner.py): there the claim must still be ours, and of a
release that is frozen nothing may have been erased since the moment; of one that is changed nothing more may wait to be
taken out. A change is tried until it is done, however often it fails: until then the release is not served. Only files
that are what was frozen are changed: a damaged one would give other figures under a checksum of their own.
"""

import hashlib
import json
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from sqlalchemy.orm import Session

import app
from app.core.errors import TadaError
from app.core.settings import Settings
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.exports.made_file import ClaimLostError, StagedFile, WorkLife, file_key, staged_file
from app.exports.release_models import Release, ReleaseFile
from app.people.access import audit
from app.people.access.secret_box import SecretBox
from app.people.models import Staff, Study
from app.privacy import queries as privacy
from app.releases import queries as releases
from app.releases.alter_release import ReleaseAlteration, Verdicts
from app.releases.freeze_release import filters_of_json, freeze
from app.releases.release_files import MANIFEST, MadeFile, ReleaseFiles, Sink, Writable
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore

PROTOCOL = (  # what a study's protocol tells of how the data came about
    *("code", "name", "marker", "expects_after_pair", "after_window_minutes", "location_policy", "location_decimals"),
    *("withdrawal_policy", "retention_days", "gives_feedback", "day_starts_minutes", "version"),
)


class FilesLostError(TadaError):
    """A file of a release is not in the store, or not what was frozen: unless it is put back, nobody can change it."""

    code = "release_files_missing"


@dataclass(frozen=True, slots=True)
class ReleaseRunner:
    """One try of one release. snapshot: a read of one moment that may take long."""

    database: Database
    blobs: BlobStore
    settings: Settings
    box: SecretBox
    claim: uuid.UUID
    snapshot: Callable[[], AbstractContextManager[Session]]

    def run(self, release: Release, life: WorkLife) -> bool:
        """Whether it is ready; False: it begins again. Raises ClaimLostError, and what goes out of order."""
        placed = _Placed(self.blobs)
        with placed:
            files = ReleaseFiles(self._sink(release, life, placed), partial(_progress, life))
            make = self._change if release.state == "changing" else self._freeze
            placed.are_named = make(release, files, placed)
        return placed.are_named

    def _freeze(self, release: Release, files: ReleaseFiles, placed: "_Placed") -> bool:
        with self.snapshot() as session:
            moment = exports.moment_of(session, release.study_id)
            study = session.get_one(Study, release.study_id)
            frozen_at = datetime.now(UTC)
            contents = freeze(session, study.id, study.code, filters_of_json(release.filters), files)
            made_by = session.get_one(Staff, release.staff_id).name
            told = {
                "study": study.code,
                "name": release.name,
                "note": release.note,
                "filters": release.filters,
                "protocol": {name: getattr(study, name) for name in PROTOCOL},
                "frozen_at": frozen_at.isoformat(),
                "frozen_by": made_by,
                "change_seq": moment.change_seq,
                "program": app.__version__,
                "contents": contents.told(),
                "altered": [],
            }
        files.add_manifest(told)
        with placed.deciding(), self.database.write() as session:
            exports.lock_study(session, release.study_id, shared=True)
            held = _held(session, release, self.claim)
            if exports.moment_of(session, release.study_id).erasures != moment.erasures:
                file_work.begin_again(held, counts=False)
                return False
            held.frozen_at, held.at_change_seq = frozen_at, moment.change_seq
            self._end(session, held, files)
            audit.note(session, None, "release.freeze", study_id=held.study_id, subject=held.name, sha256=held.checksum)
        return True

    def _change(self, release: Release, files: ReleaseFiles, placed: "_Placed") -> bool:
        with self.database.read() as session:
            changes = releases.changes_of(session, release.id)
            frozen = {file.name: file for file in releases.files_of(session, release.id)}
        done = {change.id for change in changes}
        with TemporaryDirectory(prefix="made-", dir=self.blobs.staging_folder()) as folder:
            fetched = _Fetched(self.blobs, frozen, Path(folder))
            manifest = json.loads(fetched(MANIFEST).read_bytes())
            alteration = ReleaseAlteration(manifest, fetched, Verdicts(self.box, changes))
            is_met, now = alteration.is_met(), datetime.now(UTC)
            if is_met:
                contents = alteration.write(files)
                told = {name: manifest[name] for name in manifest if name not in ("format", "tables", "files")}
                former = [*manifest["altered"], {"checksum": manifest["checksum"], "until": now.isoformat()}]
                files.add_manifest(told | {"contents": contents.told(), "altered": former})
        with placed.deciding(), self.database.write() as session:
            exports.lock_study(session, release.study_id, shared=True)
            held = _held(session, release, self.claim)
            if {change.id for change in releases.changes_of(session, held.id)} != done:
                file_work.begin_again(held, counts=False)  # something more was erased meanwhile
                return False
            releases.forget_changes(session, done)
            if is_met:
                held.former_checksums = [*held.former_checksums, [held.checksum, now.isoformat()]]
                held.altered_at = now
                self._end(session, held, files)
                audit.note(
                    session, None, "release.alter", study_id=held.study_id, subject=held.name, sha256=held.checksum
                )
            else:
                self._stay(session, held)
        return True

    def _end(self, session: Session, held: Release, files: ReleaseFiles) -> None:
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
        old = releases.replace_files(session, held.id, rows)
        privacy.want_deleted(session, old, None, datetime.now(UTC))
        held.checksum = files.checksum
        held.rows_written = sum(_rows_of_tables(files.files))
        held.bytes = sum(file.bytes for file in files.files.values())
        _ready(held)

    def _stay(self, session: Session, held: Release) -> None:
        """The release has nothing of what was erased."""
        there = releases.files_of(session, held.id)
        held.rows_written = sum(file.rows or 0 for file in there if file.name.endswith(".parquet"))
        held.bytes = sum(file.bytes for file in there)
        _ready(held)

    def _sink(self, release: Release, life: WorkLife, placed: "_Placed") -> Sink:
        """Files into the store."""
        folder = self.blobs.staging_folder()

        def keep(name: str, file: Writable) -> str:
            key = file_key("releases", release.study_id, release.id, self.claim, name, file.sha256)
            self.blobs.put_file(key, file.path)
            placed.keys.append(key)
            return key

        def new_file() -> AbstractContextManager[StagedFile]:
            return staged_file(folder, life, self.settings.export_min_free_bytes)

        return Sink(new_file, keep)


class _Placed:
    """Blobs that were sealed for a release: at the end they go again, unless rows name them.

    Nor do they go where the last transaction broke off: perhaps it was carried out. If it was not, nobody names them,
    and they go as orphans.
    """

    def __init__(self, blobs: BlobStore) -> None:
        self.keys: list[str] = []
        self.are_named = False
        self._blobs = blobs
        self._is_open = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if not self.are_named and not self._is_open:
            for key in self.keys:
                self._blobs.delete(key)

    @contextmanager
    def deciding(self) -> Iterator[None]:
        """Around the last transaction."""
        self._is_open = True
        try:
            yield
        except ClaimLostError:
            self._is_open = False
            raise
        self._is_open = False


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


def _held(session: Session, release: Release, claim: uuid.UUID) -> Release:
    held = file_work.hold(session, release, claim)
    if not isinstance(held, Release):
        raise ClaimLostError
    return held


def _ready(held: Release) -> None:
    held.state, held.finished_at = "ready", datetime.now(UTC)
    held.claim = held.heartbeat_at = held.begin_after = held.failure_code = None
    held.attempts = 0


def _progress(life: WorkLife, rows: int) -> None:
    life.rows += rows


def _rows_of_tables(files: Mapping[str, MadeFile]) -> Iterator[int]:
    return (file.rows for name, file in files.items() if name.endswith(".parquet") and file.rows is not None)
