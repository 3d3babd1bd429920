"""A file of many rows, of one moment: written into a spool while it is sent.

One thread an export reads in one transaction and writes the file into a spool (a file without a name in the store's
staging folder); the caller is sent what is there. So the snapshot lives as long as the database and the encoder need,
never as long as a slow reader does: PostgreSQL's vacuum and SQLite's log wait for seconds to minutes, and the disk
holds what has not been fetched. A reader who leaves ends it with its next piece.
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
    """An export under way: its bytes once, and what must be called at the end, whatever happens."""

    pieces: Iterator[bytes]
    close: Callable[[], None]


class SpooledExports:
    """Begins exports. min_free_bytes (settings): of the staging folder's disk, below which no export goes on."""

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
        """Begin; returns when the first bytes are there. write: the file's pieces; note: called where there is a place.

        Raises UnavailableError (`server_busy`) where others are under way, StorageFullError, and what the database
        raises. An error after the first bytes breaks the stream off, so that nobody takes a part for the whole.
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
        except BaseException as raised:  # noqa: BLE001  # a thread's edge: the reader raises it
            error = raised
            structlog.get_logger().warning("export.failed", output=name, error=type(raised).__name__)
        finally:
            spool.finish(error)


def _start(writer: threading.Thread, spool: Spool) -> None:
    """Raises UnavailableError where the system gives no thread: nobody else would end the spool then."""
    try:
        writer.start()
    except RuntimeError as error:
        spool.finish(error)
        raise UnavailableError("The server has no room for an export: try again later.", code="server_busy") from error


def _place_of(caller: Caller) -> uuid.UUID:
    return caller.participant_id if isinstance(caller, DeviceCaller) else caller.staff_id
