"""A file of many rows of one moment, which is written into a spool while it is sent.

One thread per export reads in one transaction and writes the file into a spool (an unnamed file in the store's staging
folder), from which the response is sent. So a snapshot lasts as long as the database and the encoder need, not as long
as a slow client: PostgreSQL's vacuum and SQLite's WAL are held up for seconds to minutes, and the disk holds the rest.
If the client disconnects, the thread stops at its next piece.
"""

import threading
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import structlog
from sqlalchemy.orm import Session

from app.core.errors import UnavailableError
from app.core.settings import Settings
from app.db.session import Database
from app.exports.export_places import ExportPlaces
from app.http.tables.spool import Spool, SpoolClosedError
from app.people.access.caller import Caller, DeviceCaller
from app.storage.blob_store import BlobStore


@dataclass(frozen=True, slots=True)
class SpooledFile:
    """A running export: its bytes, which can be read once, and `close`, which must be called in the end."""

    pieces: Iterator[bytes]
    close: Callable[[], None]


class SpooledExports:
    """Starts exports. An export fails if the staging folder's disk has less than settings.min_free_bytes left."""

    def __init__(self, database: Database, blobs: BlobStore, settings: Settings, places: ExportPlaces) -> None:
        self._database, self._blobs, self._settings, self._places = database, blobs, settings, places

    def __call__(
        self,
        caller: Caller,
        name: str,
        write: Callable[[Session], Iterator[bytes]],
        *,
        note: Callable[[], None] = lambda: None,
    ) -> SpooledFile:
        """Start an export; return when the first bytes are available. write: yields the file's pieces.

        note: called once a place was taken. Raises UnavailableError (`server_busy`) if other exports are running,
        StorageFullError, and the database's errors. An error after the first bytes aborts the stream, so that a part is
        not taken for the whole.
        """
        leave = self._places.take(_place_of(caller))
        try:
            note()
            spool = Spool(self._blobs.staging_folder(), self._settings.min_free_bytes)
        except BaseException:
            leave()
            raise

        def close() -> None:
            spool.close()
            leave()

        writer = threading.Thread(target=self._fill, args=(spool, name, write), name=f"export-{name}", daemon=True)
        try:
            _start(writer, spool)
            spool.wait()
        except BaseException:
            close()
            raise
        return SpooledFile(spool.read(), close)

    def _fill(self, spool: Spool, name: str, write: Callable[[Session], Iterator[bytes]]) -> None:
        error: BaseException | None = None
        try:
            with self._database.read() as session:
                for piece in write(session):
                    spool.write(piece)
        except SpoolClosedError:
            pass
        except BaseException as raised:  # noqa: BLE001  # edge of a thread: raised again by the reader
            error = raised
            structlog.get_logger().warning("export.failed", output=name, error=type(raised).__name__)
        finally:
            spool.finish(error)


def _start(writer: threading.Thread, spool: Spool) -> None:
    """Start the thread. Raises UnavailableError, after ending the spool, if the system has no thread left."""
    try:
        writer.start()
    except RuntimeError as error:
        spool.finish(error)
        raise UnavailableError("The server has no room for an export: try again later.", code="server_busy") from error


def _place_of(caller: Caller) -> uuid.UUID:
    return caller.participant_id if isinstance(caller, DeviceCaller) else caller.staff_id
