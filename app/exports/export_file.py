"""A table as a file that is sent while it is written (spooled_export.py), recorded in each study's audit log."""

from app.core.settings import Settings
from app.db.session import Database
from app.exports.export_places import ExportPlaces
from app.exports.export_spec import ExportSpec, check_spec
from app.exports.spooled_export import SpooledExports, SpooledFile
from app.exports.tables.export_tables import write_export
from app.people.access import audit
from app.people.access.caller import Caller, StaffCaller, visible_studies
from app.records.page_queries import studies_of
from app.storage.blob_store import BlobStore

ACTIONS = {  # rows -> action in the audit log
    "items": "records.export",
    "meals": "meals.export",
    "days": "days.export",
    "photographs": "photographs.export",
    "participants": "participants.export",
}


def begin_export(
    database: Database, blobs: BlobStore, settings: Settings, places: ExportPlaces, caller: Caller, spec: ExportSpec
) -> SpooledFile:
    """Start writing; return when the first bytes are available. Raises InvalidInputError, and as SpooledExports."""
    check_spec(spec)

    def note() -> None:
        if isinstance(caller, StaffCaller):
            note_export(database, caller, spec)

    begin, name = SpooledExports(database, blobs, settings, places), f"{spec.rows}-{spec.output}"
    return begin(caller, name, lambda session: write_export(session, caller, spec), note=note)


def note_export(database: Database, caller: StaffCaller, spec: ExportSpec) -> None:
    """Record the export in the audit log of each of its studies; one of all studies in the server's log.

    It is recorded once, at the start, since a partial download takes data too.
    """
    filters = spec.filters.set_names
    options = {
        name: value
        for name, value, default in (
            ("layout", spec.layout, "wide"),
            ("components", spec.components, "headline"),
        )
        if value != default
    }
    with database.write() as session:
        studies = studies_of(session, spec.filters.study_code, visible_studies(caller))
        for study_id in [None] if studies is None else studies:
            audit.note(
                session, caller, ACTIONS[spec.rows], study_id=study_id, output=spec.output, filters=filters, **options
            )
