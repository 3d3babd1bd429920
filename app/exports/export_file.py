"""A table as a file that is sent while it is written (spooled_export.py), noted in the log of each study it is of."""

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

ACTIONS = {  # in the audit log, by what a row is
    "items": "records.export",
    "meals": "meals.export",
    "days": "days.export",
    "photographs": "photographs.export",
}


def begin_export(
    database: Database, blobs: BlobStore, settings: Settings, places: ExportPlaces, caller: Caller, spec: ExportSpec
) -> SpooledFile:
    """Begin; returns when the first bytes are there. Raises InvalidInputError, and as SpooledExports."""
    check_spec(spec)

    def note() -> None:
        if isinstance(caller, StaffCaller):
            note_export(database, caller, spec)

    begin, name = SpooledExports(database, blobs, settings, places), f"{spec.rows}-{spec.output}"
    return begin(caller, name, lambda session: write_export(session, caller, spec), note=note)


def note_export(database: Database, caller: StaffCaller, spec: ExportSpec) -> None:
    """Who took data away, in the log of each study that they are of; in the admins' log for all studies at once.

    Once, at the start: a part may be taken too.
    """
    filters = spec.filters.set_names
    asked = {
        name: value
        for name, value, usual in (
            ("layout", spec.layout, "wide"),
            ("components", spec.components, "headline"),
        )
        if value != usual
    }
    with database.write() as session:
        studies = studies_of(session, spec.filters.study_code, visible_studies(caller))
        for study_id in [None] if studies is None else studies:
            audit.note(
                session, caller, ACTIONS[spec.rows], study_id=study_id, output=spec.output, filters=filters, **asked
            )
