"""All records of a filter as one file, of one moment: CSV, NDJSON or Parquet.

One thread an export reads the records in one transaction, a batch at a time, and writes the file into a spool (a file
without a name in the store's staging folder); the caller is sent what is there. So the snapshot lives as long as the
database and the encoder need, never as long as a slow reader does: PostgreSQL's vacuum and SQLite's log wait for
seconds to minutes, and the disk holds what has not been fetched. A reader who leaves ends it with its next batch.
"""

import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Literal

import structlog

from app.db.queries.record_export import export_batches
from app.db.queries.record_pages import RecordFilter, search_of, studies_of
from app.db.session import Database
from app.errors import UnavailableError
from app.exports.csv_rows import encode_csv
from app.exports.ndjson_rows import encode_ndjson
from app.exports.record_columns import RECORD_PARTS, Batch
from app.exports.spool import Spool, SpoolClosedError
from app.services import audit
from app.services.caller import Caller, DeviceCaller, StaffCaller
from app.services.export_me import ExportPlaces
from app.services.list_records import visible_records
from app.settings import Settings
from app.storage.blob_store import BlobStore

ExportFormat = Literal["csv", "ndjson", "parquet"]


@dataclass(frozen=True, slots=True)
class RecordExport:
    """An export under way: its bytes once, and what must be called at the end, whatever happens."""

    pieces: Iterator[bytes]
    close: Callable[[], None]


class ExportRecords:
    """The use case. min_free_bytes (settings): of the staging folder's disk, below which no export goes on."""

    def __init__(self, database: Database, blobs: BlobStore, settings: Settings, places: ExportPlaces) -> None:
        self._database, self._blobs, self._settings, self._places = database, blobs, settings, places

    def __call__(self, caller: Caller, chosen: RecordFilter, output: ExportFormat) -> RecordExport:
        """Begin; returns when the first bytes are there.

        Raises UnavailableError (`server_busy`) where others are under way, StorageFullError, and what the database
        raises. An error after the first bytes breaks the stream off, so that nobody takes a part for the whole.
        """
        visible = visible_records(caller, chosen)
        leave = self._places.take(_place_of(caller))
        try:
            if isinstance(caller, StaffCaller):
                self._note(caller, visible, output)
            spool = Spool(self._blobs.staging_folder(), self._settings.min_free_bytes)
        except BaseException:
            leave()
            raise

        def close() -> None:
            spool.close()
            leave()

        name = f"export-{output}"
        writer = threading.Thread(target=self._fill, args=(spool, visible, output), name=name, daemon=True)
        try:
            _start(writer, spool)
            spool.wait()
        except BaseException:
            close()
            raise
        return RecordExport(spool.read(), close)

    def _fill(self, spool: Spool, chosen: RecordFilter, output: ExportFormat) -> None:
        error: BaseException | None = None
        try:
            with self._database.read() as session:
                for piece in _encoded(output, export_batches(session, search_of(session, chosen))):
                    spool.write(piece)
        except SpoolClosedError:
            pass
        except BaseException as raised:  # noqa: BLE001  # a thread's edge: the reader raises it
            error = raised
            structlog.get_logger().warning("export.failed", output=output, error=type(raised).__name__)
        finally:
            spool.finish(error)

    def _note(self, caller: StaffCaller, chosen: RecordFilter, output: ExportFormat) -> None:
        """Who took records away, in the log of each study that they are of; in the admins' log for all studies at once.

        Once, at the start: a part may be taken too.
        """
        filters = sorted(name for name, value in asdict(chosen).items() if value and name != "study_ids")
        with self._database.write() as session:
            studies = studies_of(session, chosen.study_code, chosen.study_ids)
            for study_id in [None] if studies is None else studies:
                audit.note(session, caller, "records.export", study_id=study_id, output=output, filters=filters)


def _start(writer: threading.Thread, spool: Spool) -> None:
    """Raises UnavailableError where the system gives no thread: nobody else would end the spool then."""
    try:
        writer.start()
    except RuntimeError as error:
        spool.finish(error)
        raise UnavailableError("The server has no room for an export: try again later.", code="server_busy") from error


def _encoded(output: ExportFormat, batches: Iterable[Batch]) -> Iterator[bytes]:
    if output == "csv":
        return encode_csv(RECORD_PARTS, batches)
    if output == "ndjson":
        return encode_ndjson(RECORD_PARTS, batches)
    from app.exports.parquet_rows import encode_parquet  # noqa: PLC0415  # 60 MB, for those who ask for it

    return encode_parquet(RECORD_PARTS, batches)


def _place_of(caller: Caller) -> uuid.UUID:
    return caller.participant_id if isinstance(caller, DeviceCaller) else caller.staff_id
