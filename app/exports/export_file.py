"""A table as a file that is made at once and sent, recorded in each study's audit log."""

import uuid
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile

from pydantic import JsonValue

from app.core.settings import Settings
from app.db.session import Database
from app.exports.export_places import ExportPlaces
from app.exports.export_spec import ExportSpec, check_spec, spec_as_json
from app.exports.file_task import FileTasks
from app.people.access import audit
from app.people.access.caller import (
    Caller,
    DeviceCaller,
    StaffCaller,
    visible_rows,
    visible_studies,
)
from app.records.page_queries import participants_of, studies_of
from app.storage.blob_store import BlobStore

ACTIONS = {  # rows -> action in the audit log
    "items": "records.export",
    "meals": "meals.export",
    "days": "days.export",
    "photographs": "photographs.export",
    "participants": "participants.export",
}
MOST_SECONDS = 600.0  # longer files are made in the background
PIECE_BYTES = 256 * 1024


@dataclass(frozen=True, slots=True)
class OpenFile:
    """A file without a name: its length, its bytes, which can be read once, and what closes it."""

    length: int
    pieces: Iterator[bytes]
    close: Callable[[], None]


def make_export(
    database: Database,
    blobs: BlobStore,
    settings: Settings,
    places: ExportPlaces,
    caller: Caller,
    spec: ExportSpec,
) -> OpenFile:
    """Make the file of what the caller may see; it is gone once it is closed.

    Raises InvalidInputError, UnavailableError (`server_busy`), StorageFullError.
    """
    check_spec(spec)
    leave = places.take(_person_of(caller))
    try:
        if isinstance(caller, StaffCaller):
            note_export(database, caller, spec)
        folder = blobs.staging_folder()
        with NamedTemporaryFile(prefix="export-", dir=folder, delete=False) as file:
            path = Path(file.name)
        try:
            tasks = FileTasks(database, folder, settings.min_free_bytes)
            request = request_of(database, caller, spec, path)
            with places.processes:
                tasks.run("export", request, most_seconds=MOST_SECONDS)
            return _open_file(path, leave)
        finally:
            path.unlink(missing_ok=True)
    except BaseException:
        leave()
        raise


def _person_of(caller: Caller) -> uuid.UUID:
    return caller.participant_id if isinstance(caller, DeviceCaller) else caller.staff_id


def request_of(
    database: Database, caller: Caller, spec: ExportSpec, path: Path
) -> dict[str, JsonValue]:
    """The task's request: the spec, and whose rows the caller may see."""
    visible = visible_rows(caller, spec.filters)
    with database.read() as session:
        studies = studies_of(session, visible.study_code, visible.study_ids)
        people = participants_of(session, visible.participant_code, visible.participant_id, studies)
    return export_request(spec, studies, people, path)


def note_export(database: Database, caller: StaffCaller, spec: ExportSpec) -> None:
    """Record the export in the audit log of each of its studies; one of all in the server's log.

    It is recorded once, at the start, since a partial download takes data too.
    """
    defaults = ExportSpec(spec.rows)
    options = {
        name: getattr(spec, name)
        for name in ("layout", "components")
        if getattr(spec, name) != getattr(defaults, name)
    }
    with database.write() as session:
        studies = studies_of(session, spec.filters.study_code, visible_studies(caller))
        for study_id in [None] if studies is None else studies:
            audit.note(
                session,
                caller,
                ACTIONS[spec.rows],
                study_id=study_id,
                output=spec.output,
                filters=spec.filters.set_names,
                **options,
            )


def _open_file(path: Path, leave: Callable[[], None]) -> OpenFile:
    file = path.open("rb")

    def close() -> None:
        file.close()
        leave()

    def pieces() -> Iterator[bytes]:
        while piece := file.read(PIECE_BYTES):
            yield piece

    return OpenFile(path.stat().st_size, pieces(), close)


def export_request(
    spec: ExportSpec,
    study_ids: Collection[uuid.UUID] | None,
    participant_ids: Collection[uuid.UUID] | None,
    path: Path,
) -> dict[str, JsonValue]:
    """What export_table.py is asked. study_ids, participant_ids: whose rows; None: all."""
    return {
        "spec": spec_as_json(spec),
        "studies": _listed(study_ids),
        "participants": _listed(participant_ids),
        "path": str(path),
    }


def _listed(ids: Collection[uuid.UUID] | None) -> JsonValue:
    return None if ids is None else [str(id_) for id_ in sorted(ids)]
