"""All records of a filter as one file, of one moment: CSV, NDJSON or Parquet."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Literal

from app.db.queries.record_export import export_batches
from app.db.queries.record_pages import RecordFilter, search_of, studies_of
from app.db.session import Database
from app.exports.csv_rows import encode_csv
from app.exports.ndjson_rows import encode_ndjson
from app.exports.record_columns import RECORD_PARTS, Batch
from app.services import audit
from app.services.caller import Caller, StaffCaller
from app.services.export_me import ExportPlaces
from app.services.list_records import visible_records
from app.services.spooled_export import SpooledExports, SpooledFile
from app.settings import Settings
from app.storage.blob_store import BlobStore

ExportFormat = Literal["csv", "ndjson", "parquet"]


class ExportRecords:
    """The use case; see SpooledExports for what it raises."""

    def __init__(self, database: Database, blobs: BlobStore, settings: Settings, places: ExportPlaces) -> None:
        self._database, self._begin = database, SpooledExports(database, blobs, settings, places)

    def __call__(self, caller: Caller, chosen: RecordFilter, output: ExportFormat) -> SpooledFile:
        """Begin; returns when the first bytes are there."""
        visible = visible_records(caller, chosen)

        def note() -> None:
            if isinstance(caller, StaffCaller):
                self._note(caller, visible, output)

        return self._begin(
            caller,
            output,
            lambda session: _encoded(output, export_batches(session, search_of(session, visible))),
            note=note,
        )

    def _note(self, caller: StaffCaller, chosen: RecordFilter, output: ExportFormat) -> None:
        """Who took records away, in the log of each study that they are of; in the admins' log for all studies at once.

        Once, at the start: a part may be taken too.
        """
        filters = sorted(name for name, value in asdict(chosen).items() if value and name != "study_ids")
        with self._database.write() as session:
            studies = studies_of(session, chosen.study_code, chosen.study_ids)
            for study_id in [None] if studies is None else studies:
                audit.note(session, caller, "records.export", study_id=study_id, output=output, filters=filters)


def _encoded(output: ExportFormat, batches: Iterable[Batch]) -> Iterator[bytes]:
    if output == "csv":
        return encode_csv(RECORD_PARTS, batches)
    if output == "ndjson":
        return encode_ndjson(RECORD_PARTS, batches)
    from app.exports.parquet_rows import encode_parquet  # noqa: PLC0415  # 60 MB, for those who ask for it

    return encode_parquet(RECORD_PARTS, batches)
