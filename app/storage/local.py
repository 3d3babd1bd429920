"""Blobs as files: temporary file, fsync, rename, fsync of the folders, so that acknowledged blobs are on disk.

Syncs are slow, but concurrent ones share one write of the file system's journal. So all files of a
call are synced concurrently, then all folders up to the store's root, existing ones too, since
another upload may have just created them without having synced them.
"""

import contextlib
import os
import tempfile
import uuid
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from app.storage.blob_store import (
    BlobDamagedError,
    BlobMissingError,
    BlobStore,
    StoredBlob,
    require_valid_key,
    require_valid_prefix,
)

STAGING = ".incoming"  # no key starts with a full stop (KEY_PATTERN)
PIECE_BYTES = 256 * 1024
SYNCS_AT_ONCE = 32  # threads that only wait for the disk
MOVE_ATTEMPTS = 5  # a concurrent deletion may remove the target folder while it is empty


class LocalBlobStore(BlobStore):
    """A BlobStore in a folder of this machine."""

    def __init__(self, root: Path) -> None:
        self._root = root
        super().__init__(root / STAGING)
        self._syncs = ThreadPoolExecutor(SYNCS_AT_ONCE, thread_name_prefix="fsync")

    def put_file(self, key: str, source: Path) -> None:
        """Sync the file, rename it to its place, sync the folders."""
        self.put_files({key: source})

    def put_files(self, files: Mapping[str, Path]) -> None:
        """Put several files, syncing them concurrently."""
        if not files:
            return
        targets = {self._path(key): source for key, source in files.items()}
        self._sync(targets.values())
        for target, source in targets.items():
            _move(source, target)
        folders = {
            parent
            for target in targets
            for parent in target.parents
            if parent.is_relative_to(self._root)
        }
        self._sync(sorted(folders))

    def put_bytes(self, key: str, content: bytes) -> None:
        """Write a staged file, then put it."""
        handle, name = tempfile.mkstemp(dir=self._staging.folder)
        staged = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            self.put_file(key, staged)
        finally:
            staged.unlink(missing_ok=True)

    def stream(self, key: str, chunk_bytes: int = PIECE_BYTES) -> Generator[bytes, None, None]:
        """Open the file at once, and yield it in pieces."""
        file = self._open(key)

        def pieces() -> Generator[bytes, None, None]:
            with file:
                while piece := file.read(chunk_bytes):
                    yield piece

        return pieces()

    def stream_part(self, key: str, start: int, length: int) -> Generator[bytes, None, None]:
        """Open the file at once, and yield the part in pieces."""
        file = self._open(key)

        def pieces() -> Generator[bytes, None, None]:
            remaining = length
            with file:
                file.seek(start)
                while remaining:
                    piece = file.read(min(PIECE_BYTES, remaining))
                    if not piece:
                        raise BlobDamagedError(key)
                    remaining -= len(piece)
                    yield piece

        return pieces()

    def has(self, key: str) -> bool:
        """Return whether the file exists."""
        return self._path(key).is_file()

    def delete(self, key: str) -> None:
        """Remove the file, then its empty folders, and sync the remaining folder."""
        path = self._path(key)
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        folder = path.parent
        while folder != self._root:
            try:
                folder.rmdir()
            except FileNotFoundError:
                pass  # another deletion removed it; its parent may be empty
            except OSError:
                break  # not empty
            folder = folder.parent
        with contextlib.suppress(FileNotFoundError):
            _sync(folder)

    def keys(self, prefix: str = "") -> Iterator[StoredBlob]:
        """Walk the folder without the staging folder."""
        require_valid_prefix(prefix)
        folders = [self._root / prefix]
        while folders:
            try:
                entries = list(os.scandir(folders.pop()))
            except FileNotFoundError:
                continue
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                if entry.is_dir(follow_symlinks=False):
                    folders.append(Path(entry.path))
                    continue
                with contextlib.suppress(FileNotFoundError):
                    status = entry.stat()
                    stored_at = datetime.fromtimestamp(status.st_mtime, UTC)
                    yield StoredBlob(
                        Path(entry.path).relative_to(self._root).as_posix(),
                        stored_at,
                        status.st_size,
                    )

    def check(self) -> None:
        """Write, sync and remove a small file."""
        probe = self._staging.folder / f"probe-{uuid.uuid4().hex}"
        try:
            with probe.open("wb") as file:
                file.write(b"ok")
                os.fsync(file.fileno())
        finally:
            probe.unlink(missing_ok=True)

    def _open(self, key: str) -> BinaryIO:
        try:
            return self._path(key).open("rb")
        except FileNotFoundError:
            raise BlobMissingError(key) from None

    def _path(self, key: str) -> Path:
        require_valid_key(key)
        return self._root / key

    def _sync(self, paths: Iterable[Path]) -> None:
        """Sync files or folders concurrently. Raises errors of the disk."""
        first, *remaining = paths
        waiting = [self._syncs.submit(_sync, path) for path in remaining]
        try:
            _sync(first)
        finally:
            errors = [error for future in waiting if (error := future.exception()) is not None]
        for error in errors:
            raise error


def _move(source: Path, target: Path) -> None:
    """Rename a file, creating missing folders."""
    for tries_left in reversed(range(MOVE_ATTEMPTS)):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(source, target)  # noqa: PTH105  # the name of the system call that is atomic
        except FileNotFoundError:  # a concurrent deletion removed the empty folder
            if not tries_left:
                raise
        else:
            return


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
