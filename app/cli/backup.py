"""`tada backup` and `tada restore`: back up a deployment to one file, and restore it to an empty deployment."""

import errno
import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.database import JsonOption, unmigrated_database
from app.core.errors import InvalidInputError, StorageFullError, UnavailableError
from app.core.settings import Settings

if TYPE_CHECKING:
    from app.operations.backup.backup_format import Backup

PROGRESS_SECONDS = 2.0
LISTED = 20  # damaged blobs printed by name; --json has a thousand, the backup's lacking.jsonl all
KEPT_APART = (
    "TADA_SECRET_KEY is not in it (on SQLite: the file secret.key in TADA_DATA_DIR), nor is the ledger of erasures "
    "(TADA_ERASURE_URL). Keep both apart from the backup: a restore needs them."
)

OTHER_LEDGER = (
    "TADA_ERASURE_URL is not the ledger that the backup was made with: it lacks {} erasures that the backup records. "
    "Whoever was erased after the backup is back: erase them again before you start a server for others."
)


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write; -: standard output.")],
    as_json: JsonOption = False,
) -> None:
    """Write database and photographs to one file, as of this moment, while servers and workers continue."""
    from app.operations.backup.backup import backup_to_file, write_backup
    from app.operations.backup.last_backup import note_backup
    from app.people.access.secret_box import open_secret_box
    from app.storage.opening import open_blob_store

    settings, to_pipe = Settings(), str(file) == "-"
    with _clean_up_when_terminated(), unmigrated_database() as database, _explain_file_errors():
        blobs = open_blob_store(settings.resolved_blob_url, settings)
        box, report_progress = open_secret_box(settings), _progress()
        if to_pipe:
            written = write_backup(database, blobs, box, sys.stdout.buffer, report_progress)
            sys.stdout.buffer.flush()
        else:
            written = backup_to_file(database, blobs, box, file, report_progress)
        note_backup(database, blobs=written.end.blobs, damaged=written.end.damaged, piped=to_pipe)
    summary = _summary(written)
    if as_json:
        print(json.dumps(summary), file=sys.stderr if to_pipe else sys.stdout)
    else:
        print(f"{file}: {_counts_text(written)}.", file=sys.stderr)
        _print_damaged(written)
        print(KEPT_APART, file=sys.stderr)
    raise SystemExit(1 if written.end.damaged else 0)


def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file of `tada backup`.")],
    check: Annotated[bool, typer.Option("--check", help="Only read the whole file; restore nothing.")] = False,
    other_key: Annotated[
        bool,
        typer.Option("--other-key", help="The TADA_SECRET_KEY of the backup is lost: continue without it."),
    ] = False,
    other_ledger: Annotated[
        bool,
        typer.Option("--other-ledger", help="The ledger of erasures of the backup is lost: continue without it."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check a backup, then restore it to an empty deployment that is not running: any database, any store."""
    from app.operations.backup.restore import check_only
    from app.operations.backup.restore import restore as run
    from app.storage.opening import open_blob_store

    settings, report_progress = Settings(), _progress()
    if str(file) == "-":
        raise InvalidInputError("A backup is checked before it is restored, so it must be a file: save it first.")
    if check:
        with _explain_file_errors():
            checked = check_only(file, settings, report_progress, other_key=other_key)
        _print_checked(checked, {}, "as it was made" if checked.end.damaged else "whole", as_json=as_json)
        raise SystemExit(1 if checked.end.damaged else 0)
    with _clean_up_when_terminated(), unmigrated_database() as database, _explain_file_errors():
        blobs = open_blob_store(settings.resolved_blob_url, settings)
        restored = run(file, database, blobs, settings, report_progress, other_key=other_key, other_ledger=other_ledger)
    counts = {"queued_again": restored.queued_again, "missing_in_ledger": restored.missing_in_ledger}
    _print_checked(restored.checked, counts, "restored", as_json=as_json)
    if restored.missing_in_ledger:
        print(OTHER_LEDGER.format(restored.missing_in_ledger), file=sys.stderr)
    raise SystemExit(1 if restored.checked.end.damaged else 0)


def _print_checked(checked: "Backup", counts: dict[str, int], outcome: str, *, as_json: bool) -> None:
    summary = _summary(checked)
    if as_json:
        print(json.dumps({**summary, **counts}))
        return
    print(f"{outcome}: {_counts_text(checked)}, of {checked.manifest.created_at.isoformat(timespec='seconds')}.")
    if counts.get("queued_again"):
        print(f"{counts['queued_again']} meals wait for a worker.")
    _print_damaged(checked)


def _summary(backup: "Backup") -> dict[str, object]:
    manifest, end = backup.manifest, backup.end
    return {
        "backup": manifest.backup,
        "created_at": manifest.created_at.isoformat(),
        "program": manifest.program,
        "revision": manifest.revision,
        "database": manifest.database,
        "rows": sum(end.rows.values()),
        "tables": end.rows,
        "blobs": end.blobs,
        "blob_bytes": end.blob_bytes,
        "erased_meanwhile": end.erased,
        "damaged_blobs": end.damaged,
        "damaged": dict(backup.damaged_first),
    }


def _counts_text(backup: "Backup") -> str:
    end = backup.end
    return f"{sum(end.rows.values())} rows, {end.blobs} blobs ({end.blob_bytes / 1e6:.1f} MB)"


def _print_damaged(backup: "Backup") -> None:
    damaged = backup.end.damaged
    if not damaged:
        return
    print(f"{damaged} blobs are not in the backup:", file=sys.stderr)
    for key, why in list(backup.damaged_first.items())[:LISTED]:
        print(f"  {key}: {why}", file=sys.stderr)
    if damaged > LISTED:
        print(f"  and {damaged - LISTED} more: `tar xOf FILE lacking.jsonl`", file=sys.stderr)


def _progress() -> Callable[[str], None]:
    """Return a function that prints progress on standard error, at most every PROGRESS_SECONDS."""
    last = time.monotonic()

    def report(text: str) -> None:
        nonlocal last
        if time.monotonic() - last >= PROGRESS_SECONDS:
            last = time.monotonic()
            print(f"  {text}", file=sys.stderr, flush=True)

    return report


@contextmanager
def _clean_up_when_terminated() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into SystemExit, so that partly written files are removed as after Ctrl-C."""

    def end(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = {number: handler for number in numbers if (handler := signal.getsignal(number)) != signal.SIG_IGN}  # nohup
    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _explain_file_errors() -> Iterator[None]:
    """Turn errors of the file or the store into a TadaError with a readable message."""
    try:
        yield
    except BrokenPipeError:
        raise UnavailableError("The process that reads the backup has ended: the backup is incomplete.") from None
    except OSError as error:
        prefix = f"{error.filename}: " if error.filename else ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise StorageFullError(f"{prefix}there is no room left. Nothing was kept.") from error
        raise UnavailableError(f"{prefix}{error.strerror or error}") from error
