"""`tada backup` and `tada restore`: a deployment into one file, and an empty deployment from it."""

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

from app.cli.database import JsonOption, database_as_it_is
from app.core.errors import InvalidInputError, StorageFullError, UnavailableError
from app.core.settings import Settings

if TYPE_CHECKING:
    from app.operations.backup.backup_format import Backup

PROGRESS_SECONDS = 2.0
LISTED = 20  # damaged blobs told by name; --json tells a thousand, and the backup's lacking.jsonl all
KEPT_APART = (
    "TADA_SECRET_KEY is not in it (on SQLite: the file secret.key in TADA_DATA_DIR), nor is the ledger of erasures "
    "(TADA_ERASURE_URL). Keep both apart from the backup: a restore needs them."
)

OTHER_LEDGER = (
    "TADA_ERASURE_URL does not lead to the ledger of then: {} erasures that the backup remembers are not in it. "
    "Whoever was erased after the backup is back: erase them again before you start a server for others."
)


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to make; -: standard output.")],
    as_json: JsonOption = False,
) -> None:
    """Write database and photographs into one file, as they stand now, while servers and workers go on."""
    from app.operations.backup.backup import backup_to_file, write_backup
    from app.operations.backup.last_backup import note_backup
    from app.people.access.secret_box import open_secret_box
    from app.storage.opening import open_blob_store

    settings, to_pipe = Settings(), str(file) == "-"
    with _ended_in_order(), database_as_it_is() as database, _told_of_files():
        blobs, box, tell = open_blob_store(settings.resolved_blob_url, settings), open_secret_box(settings), _progress()
        if to_pipe:
            done = write_backup(database, blobs, box, sys.stdout.buffer, tell)
            sys.stdout.buffer.flush()
        else:
            done = backup_to_file(database, blobs, box, file, tell)
        note_backup(database, blobs=done.end.blobs, damaged=done.end.damaged, piped=to_pipe)
    answer = _described(done)
    if as_json:
        print(json.dumps(answer), file=sys.stderr if to_pipe else sys.stdout)
    else:
        print(f"{file}: {_counted(done)}.", file=sys.stderr)
        _tell_damaged(done)
        print(KEPT_APART, file=sys.stderr)
    raise SystemExit(1 if done.end.damaged else 0)


def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What `tada backup` made.")],
    check: Annotated[bool, typer.Option("--check", help="Only read it to its end; restore nothing.")] = False,
    other_key: Annotated[
        bool,
        typer.Option("--other-key", help="TADA_SECRET_KEY of then is lost: go on without it."),
    ] = False,
    other_ledger: Annotated[
        bool,
        typer.Option("--other-ledger", help="The ledger of erasures of then is lost: go on without it."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check a backup, then restore it into an empty deployment that nobody runs: any database, any store."""
    from app.operations.backup.restore import check_only
    from app.operations.backup.restore import restore as run
    from app.storage.opening import open_blob_store

    settings, tell = Settings(), _progress()
    if str(file) == "-":
        raise InvalidInputError("A backup is checked before it is restored, so it must be a file: save it first.")
    if check:
        with _told_of_files():
            checked = check_only(file, settings, tell, other_key=other_key)
        _tell_checked(checked, {}, "as it was made" if checked.end.damaged else "whole", as_json=as_json)
        raise SystemExit(1 if checked.end.damaged else 0)
    with _ended_in_order(), database_as_it_is() as database, _told_of_files():
        blobs = open_blob_store(settings.resolved_blob_url, settings)
        done = run(file, database, blobs, settings, tell, other_key=other_key, other_ledger=other_ledger)
    more = {"queued_again": done.queued_again, "missing_in_ledger": done.missing_in_ledger}
    _tell_checked(done.checked, more, "restored", as_json=as_json)
    if done.missing_in_ledger:
        print(OTHER_LEDGER.format(done.missing_in_ledger), file=sys.stderr)
    raise SystemExit(1 if done.checked.end.damaged else 0)


def _tell_checked(checked: "Backup", more: dict[str, int], deed: str, *, as_json: bool) -> None:
    answer = _described(checked)
    if as_json:
        print(json.dumps({**answer, **more}))
        return
    print(f"{deed}: {_counted(checked)}, of {checked.manifest.created_at.isoformat(timespec='seconds')}.")
    if more.get("queued_again"):
        print(f"{more['queued_again']} meals wait for a worker.")
    _tell_damaged(checked)


def _described(backup: "Backup") -> dict[str, object]:
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


def _counted(backup: "Backup") -> str:
    end = backup.end
    return f"{sum(end.rows.values())} rows, {end.blobs} blobs ({end.blob_bytes / 1e6:.1f} MB)"


def _tell_damaged(backup: "Backup") -> None:
    damaged = backup.end.damaged
    if not damaged:
        return
    print(f"{damaged} blobs are not in the backup:", file=sys.stderr)
    for key, why in list(backup.damaged_first.items())[:LISTED]:
        print(f"  {key}: {why}", file=sys.stderr)
    if damaged > LISTED:
        print(f"  and {damaged - LISTED} more: `tar xOf FILE lacking.jsonl`", file=sys.stderr)


def _progress() -> Callable[[str], None]:
    """Tells on standard error how far it is, now and then."""
    last = time.monotonic()

    def tell(words: str) -> None:
        nonlocal last
        if time.monotonic() - last >= PROGRESS_SECONDS:
            last = time.monotonic()
            print(f"  {words}", file=sys.stderr, flush=True)

    return tell


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Who is told to end (a scheduler's time limit, a lost terminal) removes what is half written, as after Ctrl-C."""

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
def _told_of_files() -> Iterator[None]:
    """What the file or the store does not do, in words."""
    try:
        yield
    except BrokenPipeError:
        raise UnavailableError("Whoever read the backup has gone: it is not whole.") from None
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise StorageFullError(f"{where}there is no room left. Nothing was kept.") from error
        raise UnavailableError(f"{where}{error.strerror or error}") from error
