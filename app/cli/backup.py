"""`tada backup` and `tada restore`: a deployment to one file, and into an empty deployment."""

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
from app.core.errors import InvalidInputError, UnavailableError
from app.core.settings import Settings

if TYPE_CHECKING:
    from app.operations.backup.archive import Backup

PROGRESS_SECONDS = 2.0
LISTED = 20  # damaged blobs printed by name; --json has a thousand, the backup's lacking.jsonl all
LOST = "the backup is lost: continue without it."
KEPT_APART = (
    "TADA_SECRET_KEY is not in it (on SQLite: the file secret.key in TADA_DATA_DIR), nor is the "
    "ledger of erasures (TADA_ERASURE_URL). Keep both apart from the backup: a restore needs them."
)
OTHER_LEDGER = (
    "TADA_ERASURE_URL is not the ledger that the backup was made with: it lacks {} erasures that "
    "the backup records. Whoever was erased after the backup is back: erase them again before you "
    "start a server for others."
)

WrittenFile = Annotated[
    Path,
    typer.Argument(metavar="FILE", help="File to write; -: standard output."),
]
ReadFile = Annotated[Path, typer.Argument(metavar="FILE", help="A file of `tada backup`.")]
Check = Annotated[bool, typer.Option("--check", help="Only read the whole file; restore nothing.")]
OtherKey = Annotated[bool, typer.Option("--other-key", help=f"The TADA_SECRET_KEY of {LOST}")]
OtherLedger = Annotated[
    bool,
    typer.Option("--other-ledger", help=f"The ledger of erasures of {LOST}"),
]


def backup(file: WrittenFile, as_json: JsonOption = False) -> None:
    """Write database and photographs to one file, as of this moment, while servers continue."""
    from app.operations.backup.write_backup import backup_to_file, note_backup, write_backup
    from app.people.access.secret_box import open_secret_box
    from app.storage.opening import open_blob_store

    settings, to_pipe = Settings(), str(file) == "-"
    with _clean_up_when_terminated(), unmigrated_database() as database:
        blobs = open_blob_store(settings.resolved_blob_url, settings)
        box, report = open_secret_box(settings), _progress()
        if to_pipe:
            try:
                written = write_backup(database, blobs, box, sys.stdout.buffer, report)
                sys.stdout.buffer.flush()
            except BrokenPipeError:
                raise UnavailableError(
                    "The process that reads the backup has ended: the backup is incomplete."
                ) from None
        else:
            written = backup_to_file(database, blobs, box, file, report)
        note_backup(database, blobs=written.blobs, damaged=written.damaged_blobs, piped=to_pipe)
    if as_json:
        print(json.dumps(_summary(written)), file=sys.stderr if to_pipe else sys.stdout)
    else:
        print(f"{file}: {_counts_text(written)}.", file=sys.stderr)
        _print_damaged(written)
        print(KEPT_APART, file=sys.stderr)
    raise SystemExit(1 if written.damaged_blobs else 0)


def restore(
    file: ReadFile,
    check: Check = False,
    other_key: OtherKey = False,
    other_ledger: OtherLedger = False,
    as_json: JsonOption = False,
) -> None:
    """Check a backup, then restore it to an empty deployment that is not running.

    Any database, any store.
    """
    from app.operations.backup.restore import check_backup
    from app.operations.backup.restore import restore as run
    from app.operations.explain_errors import explained_errors
    from app.storage.opening import open_blob_store

    settings, report, counts = Settings(), _progress(), {}
    if str(file) == "-":
        raise InvalidInputError(
            "A backup is checked before it is restored, so it must be a file: save it first.",
        )
    if check:
        with explained_errors(), file.open("rb") as content:
            checked: Backup = check_backup(content, settings, report, other_key=other_key)
        outcome = "as it was made" if checked.damaged_blobs else "whole"
    else:
        with _clean_up_when_terminated(), unmigrated_database() as database:
            blobs = open_blob_store(settings.resolved_blob_url, settings)
            lost = {"other_key": other_key, "other_ledger": other_ledger}
            done = run(file, database, blobs, settings, report, **lost)
        checked, outcome = done.checked, "restored"
        counts = {"queued_again": done.queued_again, "missing_in_ledger": done.missing_in_ledger}
    if as_json:
        print(json.dumps({**_summary(checked), **counts}))
    else:
        made_at = checked.manifest.created_at.isoformat(timespec="seconds")
        print(f"{outcome}: {_counts_text(checked)}, of {made_at}.")
        if counts.get("queued_again"):
            print(f"{counts['queued_again']} meals wait for a worker.")
        _print_damaged(checked)
    if counts.get("missing_in_ledger"):
        print(OTHER_LEDGER.format(counts["missing_in_ledger"]), file=sys.stderr)
    raise SystemExit(1 if checked.damaged_blobs else 0)


def _summary(backup: "Backup") -> dict[str, object]:
    return {
        **backup.manifest.model_dump(mode="json", exclude={"format"}),
        "rows": sum(backup.tables.values()),
        "tables": backup.tables,
        "blobs": backup.blobs,
        "blob_bytes": backup.blob_bytes,
        "erased_meanwhile": len(backup.erased),
        "damaged_blobs": backup.damaged_blobs,
        "damaged": backup.damaged,
    }


def _counts_text(backup: "Backup") -> str:
    rows, megabytes = sum(backup.tables.values()), backup.blob_bytes / 1e6
    return f"{rows} rows, {backup.blobs} blobs ({megabytes:.1f} MB)"


def _print_damaged(backup: "Backup") -> None:
    if not backup.damaged_blobs:
        return
    print(f"{backup.damaged_blobs} blobs are not in the backup:", file=sys.stderr)
    for key, reason in list(backup.damaged.items())[:LISTED]:
        print(f"  {key}: {reason}", file=sys.stderr)
    unlisted = backup.damaged_blobs - LISTED
    if unlisted > 0:
        print(f"  and {unlisted} more: `tar xOf FILE lacking.jsonl`", file=sys.stderr)


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
    """Turn SIGTERM and SIGHUP into SystemExit, so that partial files are removed."""

    def end(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    for number, handler in before.items():
        if handler != signal.SIG_IGN:  # nohup
            signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
