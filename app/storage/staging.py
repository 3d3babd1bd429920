"""Staging folders for temporary files: each open store has its own until its process ends.

Beside each folder is a lock file that its process keeps locked. The kernel releases the lock with the process, so an
abandoned folder is recognised at once and without a clock, which might jump and make current files look old.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
import weakref
from pathlib import Path

LOCK_SUFFIX = ".lock"
PARTIAL = "partial"


class Staging:
    """A private folder in `parent`, which is created if needed and cleared of folders of dead processes.

    Raises OSError, also if the file system has no locks.
    """

    def __init__(self, parent: Path) -> None:
        parent.mkdir(parents=True, exist_ok=True)
        self._parent = parent
        self.remove_abandoned()
        lock, handle = _new_lock(parent)
        self.folder = lock.with_suffix("")
        self.folder.mkdir()
        weakref.finalize(self, _release, lock, handle)

    def partial_folder(self) -> Path:
        """Return the folder for uploads that are continued later, maybe by another process of this machine."""
        folder = self._parent / PARTIAL
        folder.mkdir(exist_ok=True)
        return folder

    def remove_abandoned(self) -> None:
        """Remove the folders of dead processes."""
        for path in list(self._parent.iterdir()):
            with contextlib.suppress(FileNotFoundError):  # another process is cleaning up too
                if path.suffix == LOCK_SUFFIX:
                    _remove_if_unlocked(path)


def _new_lock(parent: Path) -> tuple[Path, int]:
    """Create a locked file; return it and its open handle."""
    while True:
        handle, name = tempfile.mkstemp(suffix=LOCK_SUFFIX, dir=parent)
        fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:
            return Path(name), handle
        os.close(handle)  # another process removed it as abandoned before it was locked


def _remove_if_unlocked(lock: Path) -> None:
    with lock.open("rb+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return
        _remove(lock)


def _remove(lock: Path) -> None:
    """Remove the folder, then its lock."""
    with contextlib.suppress(FileNotFoundError):  # its process died before creating it
        shutil.rmtree(lock.with_suffix(""))
    lock.unlink(missing_ok=True)


def _release(lock: Path, handle: int) -> None:
    with contextlib.suppress(OSError):  # otherwise another process removes it later
        _remove(lock)
    os.close(handle)
