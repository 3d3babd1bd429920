"""Store the blobs of a verified backup: a few at a time, each verified again; durable when it returns."""

import contextlib
import os
import tempfile
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import IO

from app.operations.backup.backup import ReportProgress
from app.operations.backup.backup_blobs import sha256_of_key
from app.operations.backup.backup_format import BLOBS, broken
from app.operations.backup.backup_tar import Member, members
from app.storage.blob_store import BlobStore

WRITERS = 4  # concurrent, since a store waits for disk or network
AHEAD = 8  # blobs staged and not yet durable


def put_blobs(file: IO[bytes], offset: int, blobs: BlobStore, report_progress: ReportProgress) -> None:
    """Store all blobs of the backup; offset: of the first one. Repeating it is harmless. Raises OSError."""
    waiting: deque[Future[None]] = deque()
    count = size = 0
    with ThreadPoolExecutor(WRITERS, thread_name_prefix="restore") as writers:
        for member in members(file, offset):
            if not member.name.startswith(BLOBS):
                break
            key = member.name.removeprefix(BLOBS)
            waiting.append(writers.submit(_put, blobs, key, _staged(member, key, blobs.staging_folder())))
            count, size = count + 1, size + member.size
            if len(waiting) >= AHEAD:
                waiting.popleft().result()
            report_progress(f"restored: {count} blobs, {size / 1e6:.0f} MB")
        while waiting:
            waiting.popleft().result()


def _staged(member: Member, key: str, folder: Path) -> Path:
    handle, name = tempfile.mkstemp(dir=folder)
    staged, is_right = Path(name), False
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines(member.pieces())
        is_right = member.sha256 == sha256_of_key(key)
    finally:
        if not is_right:
            staged.unlink(missing_ok=True)
    if not is_right:
        raise broken("it was changed while it was read")
    return staged


def _put(blobs: BlobStore, key: str, staged: Path) -> None:
    try:
        blobs.put_file(key, staged)
    finally:
        with contextlib.suppress(FileNotFoundError):
            staged.unlink()
