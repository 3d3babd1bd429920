"""Freezing a release, or making its next version without erased data.

As for exports, only the last transaction counts (file_runner.py): the claim must still hold; for a new release nothing
may have been erased since its moment; for a changed one no further removal may be pending. A release is not served
until its next version is made. Only undamaged files are rewritten: damaged ones are deleted, and the release fails.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import JsonValue
from sqlalchemy.orm import Session

import app
from app.core.errors import TadaError
from app.exports import queries as exports
from app.exports.made_file import Attempt
from app.exports.release_models import Release, ReleaseFile
from app.exports.releases import queries as releases
from app.exports.releases.alter_release import Verdicts, alter_tables
from app.exports.releases.freeze_release import columns_of_json, contents_of
from app.exports.releases.manifest import (
    FormerChecksum,
    MadeFile,
    Manifest,
    checksum_of,
    facts_of,
    manifest_text,
)
from app.exports.releases.tables import DICTIONARY, FORMER_MANIFEST, MANIFEST
from app.http.columns.dictionary import dictionary_csv, entries
from app.meals.stored.receive_photo import sha256_of_file
from app.people import privacy_queries as privacy
from app.people.access import audit
from app.people.access.secret_box import SecretBox
from app.people.models import Staff, Study
from app.storage.blob_store import BlobDamagedError, BlobMissingError, BlobStore

PROTOCOL = (  # parts of a study's protocol that explain the data
    "code",
    "name",
    "marker",
    "expects_after_pair",
    "after_window_minutes",
    "location_policy",
    "location_decimals",
    "withdrawal_policy",
    "retention_days",
    "gives_feedback",
    "identifies_by_context",
    "day_starts_minutes",
    "version",
)


class FilesLostError(TadaError):
    """A file of a release is missing or damaged in the store: its next version cannot be made."""

    code = "release_files_missing"


def make_release(attempt: Attempt[Release], box: SecretBox) -> bool:
    """Freeze a release, or make its next version without erased data.

    Returns whether it is ready; False if it has to begin again.
    Raises ClaimLostError, FilesLostError and others.
    """
    return _alter(attempt, box) if attempt.work.state == "changing" else _freeze(attempt)


def write_files(folder: Path, tables: Mapping[str, Any]) -> dict[str, int | None]:
    """Add the dictionary to a folder of tables; return its files' names and their rows.

    tables: what write_pair returned, by name.
    """
    columns = {name: columns_of_json(table["columns"]) for name, table in tables.items()}
    listed = [(name, *entry) for name in sorted(columns) for entry in entries(columns[name])]
    (folder / DICTIONARY).write_bytes(dictionary_csv(listed, ["table"]))
    rows: dict[str, int | None] = {DICTIONARY: len(listed)}
    for name, table in tables.items():
        rows |= dict.fromkeys((f"{name}.parquet", f"{name}.csv"), table["rows"])
    return rows


def _freeze(attempt: Attempt[Release]) -> bool:
    release = attempt.work
    with attempt.database.read() as session:
        moment = exports.moment_of(session, release.study_id)
        study = session.get_one(Study, release.study_id)
        frozen_by = session.get_one(Staff, release.staff_id).name
    frozen_at = datetime.now(UTC)
    with attempt.folder() as folder:
        tables = attempt.run("freeze", freeze_request(release, folder), folder)
        facts: dict[str, JsonValue] = {
            "study": study.code,
            "name": release.name,
            "note": release.note,
            "filters": release.filters,
            "protocol": {name: getattr(study, name) for name in PROTOCOL},
            "frozen_at": frozen_at.isoformat(),
            "frozen_by": frozen_by,
            "change_seq": moment.change_seq,
            "program": app.__version__,
            "altered": [],
        }
        files = _seal_all(attempt, folder, tables, facts)

    def end(session: Session, held: Release) -> None:
        held.frozen_at, held.at_change_seq = frozen_at, moment.change_seq
        _replace_files(session, held, files)
        audit.note(
            session,
            None,
            "release.freeze",
            study_id=held.study_id,
            subject=held.name,
            sha256=held.checksum,
        )

    return attempt.finish(
        lambda session: exports.erasures_since(session, release.study_id, moment) == 0, end
    )


def freeze_request(release: Release, folder: Path) -> dict[str, JsonValue]:
    """What freeze_tables is asked."""
    return {
        "study_id": str(release.study_id),
        "filters": release.filters,
        "folder": str(folder),
    }


def _alter(attempt: Attempt[Release], box: SecretBox) -> bool:
    release = attempt.work
    with attempt.database.read() as session:
        changes = releases.changes_of(session, release.id)
        frozen = {file.name: file for file in releases.files_of(session, release.id)}
    done = {change.id for change in changes}
    now = datetime.now(UTC)
    with attempt.folder() as former, attempt.folder() as folder:
        _fetch_all(attempt.blobs, frozen, former)
        name = MANIFEST if MANIFEST in frozen else FORMER_MANIFEST
        facts = facts_of((former / name).read_bytes())
        manifest = Manifest.model_validate(facts)
        tables = alter_tables(former, manifest, Verdicts(box, changes), folder)
        files: list[MadeFile] = []
        if tables is not None:
            last = FormerChecksum(checksum=manifest.checksum, until=now.isoformat())
            altered: list[JsonValue] = [
                checksum.model_dump() for checksum in (*manifest.altered, last)
            ]
            files = _seal_all(attempt, folder, tables, {**facts, "altered": altered})

    def end(session: Session, held: Release) -> None:
        releases.forget_changes(session, done)
        if not files:
            _become_ready(held, [(file.name, file.rows, file.bytes) for file in frozen.values()])
            return
        held.former_checksums = [*held.former_checksums, [held.checksum, now.isoformat()]]
        held.altered_at = now
        _replace_files(session, held, files)
        audit.note(
            session,
            None,
            "release.alter",
            study_id=held.study_id,
            subject=held.name,
            sha256=held.checksum,
        )

    def is_all(session: Session) -> bool:
        return {change.id for change in releases.changes_of(session, release.id)} == done

    return attempt.finish(is_all, end)


def _seal_all(
    attempt: Attempt[Release],
    folder: Path,
    tables: Mapping[str, Any],
    facts: Mapping[str, JsonValue],
) -> list[MadeFile]:
    """Add dictionary and manifest to a folder of tables, and give all its files to the store."""
    facts = {**facts, "contents": contents_of(folder)}
    files = [
        _sealed(attempt, folder / name, rows)
        for name, rows in sorted(write_files(folder, tables).items())
    ]
    columns = {name: columns_of_json(table["columns"]) for name, table in tables.items()}
    (folder / MANIFEST).write_bytes(manifest_text(facts, columns, files))
    return [*files, _sealed(attempt, folder / MANIFEST, None)]


def _sealed(attempt: Attempt[Release], path: Path, rows: int | None) -> MadeFile:
    sealed = attempt.seal(path, path.name)
    return MadeFile(path.name, rows, sealed.length, sealed.sha256, sealed.key)


def _replace_files(session: Session, held: Release, files: Sequence[MadeFile]) -> None:
    """Replace the release's files and mark the former ones for deletion."""
    rows = [
        ReleaseFile(
            release_id=held.id,
            name=file.name,
            rows=file.rows,
            bytes=file.bytes,
            sha256=file.sha256,
            blob_key=file.key,
        )
        for file in files
    ]
    former = releases.replace_files(session, held.id, rows)
    privacy.schedule_deletion(session, former, datetime.now(UTC))
    held.checksum = checksum_of({file.name: file.sha256 for file in files})
    _become_ready(held, [(file.name, file.rows, file.bytes) for file in files])


def _become_ready(held: Release, files: Sequence[tuple[str, int | None, int]]) -> None:
    """files: name, rows, bytes."""
    tables = [rows for name, rows, _ in files if name.endswith(".parquet")]
    held.rows_written = sum(rows for rows in tables if rows is not None)
    held.bytes = sum(length for _, _, length in files)
    held.state, held.finished_at = "ready", datetime.now(UTC)
    held.begin_after = held.failure_code = None
    held.attempts = 0


def _fetch_all(blobs: BlobStore, files: Mapping[str, ReleaseFile], folder: Path) -> None:
    """Fetch the tables and the manifest, each as it was frozen. Raises FilesLostError."""
    for name, file in files.items():
        if name.endswith(".csv"):
            continue
        path = folder / name
        damaged = FilesLostError(
            f"{file.blob_key} is not what was frozen.", code="release_files_damaged"
        )
        try:
            blobs.fetch(file.blob_key, path)
        except BlobMissingError:
            raise FilesLostError(f"{file.blob_key} is not in the store.") from None
        except BlobDamagedError:
            raise damaged from None
        if sha256_of_file(path) != file.sha256:
            raise damaged
