"""The folder of files in the making: each store that is open has one of its own in it, until its process ends.

Beside each such folder lies a file that its process holds locked. The kernel takes the lock away with the process, so
whether a folder is abandoned is known at once and without a clock: one that jumps would make files that are being
written look old.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
import weakref
from pathlib import Path

LOCK_SUFFIX = ".lock"


class Staging:
    """A folder of our own in `parent`, which is made if need be and freed of what processes that died left there.

    Raises OSError, also where the file system has no locks.
    """

    def __init__(self, parent: Path) -> None:
        parent.mkdir(parents=True, exist_ok=True)
        self._parent = parent
        self.remove_abandoned()
        lock, handle = _new_lock(parent)
        self.folder = lock.with_suffix("")
        self.folder.mkdir()
        weakref.finalize(self, _give_up, lock, handle)

    def remove_abandoned(self) -> None:
        """Remove the folders of processes that died."""
        for path in list(self._parent.iterdir()):
            with contextlib.suppress(FileNotFoundError):  # another process cleans up at the same time
                if path.suffix == LOCK_SUFFIX:
                    _remove_if_unlocked(path)


def _new_lock(parent: Path) -> tuple[Path, int]:
    """A new file that is locked, and its open handle."""
    while True:
        handle, name = tempfile.mkstemp(suffix=LOCK_SUFFIX, dir=parent)
        fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:
            return Path(name), handle
        os.close(handle)  # another process had it for abandoned in the moment before it was locked


def _remove_if_unlocked(lock: Path) -> None:
    with lock.open("rb+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return
        _remove(lock)


def _remove(lock: Path) -> None:
    """The folder, then its lock."""
    with contextlib.suppress(FileNotFoundError):  # its process died before it had made it
        shutil.rmtree(lock.with_suffix(""))
    lock.unlink(missing_ok=True)


def _give_up(lock: Path, handle: int) -> None:
    with contextlib.suppress(OSError):  # what cannot be removed now is, once this process has died
        _remove(lock)
    os.close(handle)
