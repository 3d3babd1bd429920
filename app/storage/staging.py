"""The folder of files in the making: made at a store's start, and freed of what processes that died left in it."""

import contextlib
import shutil
import time
from pathlib import Path

ABANDONED_SECONDS = 3600  # what nobody has touched for so long belonged to a process that died


def open_staging(folder: Path) -> Path:
    """Make the folder and tidy it up."""
    folder.mkdir(parents=True, exist_ok=True)
    remove_abandoned(folder)
    return folder


def remove_abandoned(folder: Path) -> None:
    """Remove what nobody has touched for an hour."""
    limit = time.time() - ABANDONED_SECONDS
    for path in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):  # another process cleans up at the same time
            if path.stat().st_mtime < limit:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
