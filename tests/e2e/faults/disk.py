"""A small disk that can be filled: a tmpfs where this process may mount one, else fsync that says it is full.

Mounting needs root, as in a container of CI. Elsewhere launch.py's fsync fails with ENOSPC while the disk is full: our
own files are then refused as on a full disk, the database's are not. Which of them it was stands in the table.
"""

import contextlib
import subprocess

MEBIBYTE = 1024 * 1024


class Disk:
    """folder: where it is. switches: launch.py's folder, for the way without a mount."""

    def __init__(self, folder, switches, mebibytes):
        self.folder = folder
        self._switches = switches
        folder.mkdir(parents=True)
        mount = ["mount", "-t", "tmpfs", "-o", f"size={mebibytes}m,mode=755", "tada-faults", str(folder)]
        try:
            self.is_mounted = subprocess.run(mount, check=False, capture_output=True).returncode == 0
        except FileNotFoundError:
            self.is_mounted = False

    def fill(self):
        """Leave not a byte."""
        if not self.is_mounted:
            (self._switches / "full").touch()
            return
        with (self.folder / "filler").open("wb", buffering=0) as filler:
            for size in (MEBIBYTE, 4096, 1):
                with contextlib.suppress(OSError):
                    while filler.write(bytes(size)):
                        pass

    def free(self):
        (self._switches / "full").unlink(missing_ok=True)
        (self.folder / "filler").unlink(missing_ok=True)

    def close(self):
        if self.is_mounted:
            subprocess.run(["umount", "-l", str(self.folder)], check=True)
            self.is_mounted = False
