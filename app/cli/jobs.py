"""The commands `tada jobs ...`: what waits for an estimate, what failed; retry it, or call it off."""

import json
import sys
import uuid
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Annotated, NoReturn

import typer

from app.cli.database import JsonOption, opened_database
from app.core.errors import InvalidInputError, TadaError

jobs_cli = typer.Typer(no_args_is_help=True, help="Estimates that wait, run or failed.")

MealsArgument = Annotated[list[uuid.UUID] | None, typer.Argument(metavar="MEAL...", help="Ids that the phones made.")]
StudyOption = Annotated[str | None, typer.Option(metavar="CODE", help="Only of this study.")]
CodeOption = Annotated[str | None, typer.Option(metavar="CODE", help="Only what failed with this code.")]
SinceOption = Annotated[
    str | None,
    typer.Option(metavar="TIME", help="Only what failed then or later: 2026-11-22 or 2026-11-22T08:00+01:00."),
]
ParticipantOption = Annotated[
    str | None, typer.Option(metavar="CODE", help="Whose meal, if the id alone is not enough.")
]


@jobs_cli.command("list")
def jobs_list(
    failed: Annotated[bool, typer.Option("--failed", help="What failed, instead of what waits or runs.")] = False,
    study: StudyOption = None,
    code: CodeOption = None,
    since: SinceOption = None,
    limit: Annotated[int, typer.Option(min=1, max=10_000)] = 100,
    as_json: JsonOption = False,
) -> None:
    """What waits or runs, in the order of its turns; with --failed, what failed, the last one first."""
    from app.uploads.job_list_queries import FailedFilter
    from app.uploads.look_after_jobs import failed_pairs, waiting_jobs

    if not failed and (code is not None or since is not None):
        raise InvalidInputError("--code and --since are of what failed: add --failed.")
    with opened_database() as database:
        if failed:
            rows = failed_pairs(database, FailedFilter(study, code, _instant(since)), limit=limit)
        else:
            rows = waiting_jobs(database, study_code=study, limit=limit)
    if as_json:
        print(json.dumps([asdict(row) for row in rows], default=str))
        return
    for row in rows:
        at = row.since.isoformat(timespec="seconds") if row.since is not None else "-"
        whose = f"{row.study}/{row.participant}"
        print(f"{at}  {row.state:10}  {row.purpose:9}  {row.meal}  {whose}  {row.code or ''}".rstrip())
    if len(rows) == limit:
        print(f"The first {limit}: --limit shows more.", file=sys.stderr)


@jobs_cli.command("retry")
def jobs_retry(
    meals: MealsArgument = None,
    code: CodeOption = None,
    since: SinceOption = None,
    study: StudyOption = None,
    participant: ParticipantOption = None,
) -> None:
    """Have meals that failed estimated again: those named, or all that failed with --code."""
    from app.jobs.queue import JobQueue
    from app.uploads.job_list_queries import FailedFilter
    from app.uploads.look_after_jobs import retry_failed, retry_named

    if bool(meals) == (code is not None):
        raise InvalidInputError("Name meals, or say with --code which failures.")
    if meals and (since is not None or study is not None):
        raise InvalidInputError("--since and --study go with --code.")
    instant, queue = _instant(since), JobQueue()
    with opened_database() as database:
        if not meals:
            done = retry_failed(database, queue, FailedFilter(study, code, instant))
            print(f"{done.queued} meals queued again")
            for why, count in sorted(done.left.items()):
                print(f"{count} left as they are: {why}")
            return
        _of_each(meals, lambda meal: retry_named(database, queue, meal, participant), "queued again", "waits already")


@jobs_cli.command("cancel")
def jobs_cancel(
    meals: Annotated[list[uuid.UUID], typer.Argument(metavar="MEAL...", help="Ids that the phones made.")],
    participant: ParticipantOption = None,
) -> None:
    """Call off estimates that are not made yet: the meals fail with the code cancelled, and can be retried."""
    from app.uploads.look_after_jobs import cancel_named

    with opened_database() as database:
        _of_each(meals, lambda meal: cancel_named(database, meal, participant), "cancelled", "was cancelled before")


def _of_each(meals: list[uuid.UUID], act: Callable[[uuid.UUID], bool], done: str, done_before: str) -> NoReturn:
    """Print what came of each meal, and end. act: returns whether it changed anything."""
    refused = 0
    for meal in meals:
        try:
            is_new = act(meal)
        except TadaError as error:
            refused += 1
            print(f"tada: {meal}: {error.message}", file=sys.stderr)
        else:
            print(f"{meal}: {done if is_new else done_before}")
    raise SystemExit(1 if refused else 0)


def _instant(text: str | None) -> datetime | None:
    """A time with its offset; without one, UTC. Raises InvalidInputError."""
    if text is None:
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise InvalidInputError(f"{text!r} is no time: write it like 2026-11-22T08:00+01:00.") from None
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)
