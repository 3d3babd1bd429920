"""A file that one thread writes and another reads at the same time: the writer never waits for the reader.

Whoever fills it from a database is done as soon as the database is, however slowly the reader takes what there is. The
file has no name: it is gone once both have let go of it, and when the process dies.
"""

import os
import shutil
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

from app.core.errors import StorageFullError

PIECE_BYTES = 256 * 1024
ROOM_CHECKED_EVERY_BYTES = 16 * 1024 * 1024


class SpoolClosedError(Exception):
    """The reader has gone: there is nobody left to write for."""


class Spool:
    """Bytes in their order. min_free_bytes: of the folder's disk, below which nothing more is written."""

    def __init__(self, folder: Path, min_free_bytes: int) -> None:
        self._folder, self._min_free_bytes = folder, min_free_bytes
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115  # closed when both have let go
        self._written = 0
        self._checked_at = -ROOM_CHECKED_EVERY_BYTES
        self._error: BaseException | None = None
        self._is_finished = False
        self._is_closed = False
        self._changed = threading.Condition()

    def write(self, data: bytes) -> None:
        """Append. Raises SpoolClosedError once the reader has gone, StorageFullError."""
        if self._is_closed:
            raise SpoolClosedError
        if self._written - self._checked_at >= ROOM_CHECKED_EVERY_BYTES:
            self._checked_at = self._written
            if shutil.disk_usage(self._folder).free < self._min_free_bytes:
                raise StorageFullError("The server's disk has no room for the export: try again later.")
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) or 0 :]
        with self._changed:
            self._written += len(data)
            self._changed.notify()

    def finish(self, error: BaseException | None = None) -> None:
        """Nothing more is written; error: what the reader is told behind the bytes that are there."""
        with self._changed:
            self._error, self._is_finished = error, True
            self._changed.notify()
            self._let_go()

    def wait(self) -> None:
        """Until there is something to read, or it is finished. Raises the writer's error if nothing was written."""
        with self._changed:
            self._changed.wait_for(lambda: self._written > 0 or self._is_finished)
            if self._error is not None and self._written == 0:
                raise self._error

    def read(self) -> Iterator[bytes]:
        """All bytes, once. Raises the writer's error behind the last of them."""
        place = 0
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._written > place or self._is_finished)  # noqa: B023  # called at once
                end = self._written
            while place < end:
                piece = os.pread(self._file.fileno(), min(PIECE_BYTES, end - place), place)
                place += len(piece)
                yield piece
            with self._changed:
                if self._is_finished and place == self._written:
                    if self._error is not None:
                        raise self._error
                    return

    def close(self) -> None:
        """The reader's end; the writer learns of it with its next bytes."""
        with self._changed:
            self._is_closed = True
            self._let_go()

    def _let_go(self) -> None:
        if self._is_finished and self._is_closed:
            self._file.close()
