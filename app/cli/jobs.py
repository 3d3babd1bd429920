"""The commands `tada jobs ...`: list waiting and failed estimates, retry or cancel them."""

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

MealsArgument = Annotated[
    list[uuid.UUID] | None, typer.Argument(metavar="MEAL...", help="Ids made by the phones.")
]
StudyOption = Annotated[str | None, typer.Option(metavar="CODE", help="Only of this study.")]
CodeOption = Annotated[
    str | None, typer.Option(metavar="CODE", help="Only failures with this code.")
]
SinceOption = Annotated[
    str | None,
    typer.Option(
        metavar="TIME", help="Only failures since this time: 2026-11-22 or 2026-11-22T08:00+01:00."
    ),
]
ParticipantOption = Annotated[
    str | None, typer.Option(metavar="CODE", help="The participant, if the id is not unique.")
]


@jobs_cli.command("list")
def jobs_list(
    failed: Annotated[
        bool, typer.Option("--failed", help="Failed estimates instead of waiting and running ones.")
    ] = False,
    study: StudyOption = None,
    code: CodeOption = None,
    since: SinceOption = None,
    limit: Annotated[int, typer.Option(min=1, max=10_000)] = 100,
    as_json: JsonOption = False,
) -> None:
    """List waiting and running estimates in queue order; with --failed, failed ones, the latest first."""
    from app.meals.upload.look_after_jobs import FailedFilter, failed_pairs, waiting_jobs

    if not failed and (code is not None or since is not None):
        raise InvalidInputError("--code and --since select failures: add --failed.")
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
        participant = f"{row.study}/{row.participant}"
        print(
            f"{at}  {row.state:10}  {row.purpose:9}  {row.meal}  {participant}  {row.code or ''}".rstrip()
        )
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
    """Estimate failed meals again: those given, or all that failed with --code."""
    from app.jobs.queue import JobQueue
    from app.meals.upload.look_after_jobs import FailedFilter, retry_failed, retry_named

    if bool(meals) == (code is not None):
        raise InvalidInputError("Give meals, or select failures with --code.")
    if meals and (since is not None or study is not None):
        raise InvalidInputError("--since and --study go with --code.")
    instant, queue = _instant(since), JobQueue()
    with opened_database() as database:
        if not meals:
            report = retry_failed(database, queue, FailedFilter(study, code, instant))
            print(f"{report.queued} meals queued again")
            for reason, count in sorted(report.left.items()):
                print(f"{count} not queued: {reason}")
            return
        _apply_to_each(
            meals,
            lambda meal: retry_named(database, queue, meal, participant),
            "queued again",
            "waits already",
        )


@jobs_cli.command("cancel")
def jobs_cancel(
    meals: Annotated[
        list[uuid.UUID], typer.Argument(metavar="MEAL...", help="Ids made by the phones.")
    ],
    participant: ParticipantOption = None,
) -> None:
    """Cancel estimates that have not finished: the meals fail with the code cancelled and can be retried."""
    from app.meals.upload.look_after_jobs import cancel_named

    with opened_database() as database:
        _apply_to_each(
            meals,
            lambda meal: cancel_named(database, meal, participant),
            "cancelled",
            "was cancelled before",
        )


def _apply_to_each(
    meals: list[uuid.UUID], act: Callable[[uuid.UUID], bool], done: str, done_before: str
) -> NoReturn:
    """Apply an action to each meal, print the results and exit.

    act: returns whether it changed anything.
    """
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
    """Parse a time; without an offset it is UTC. Raises InvalidInputError."""
    if text is None:
        return None
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise InvalidInputError(
            f"{text!r} is not a time: write it like 2026-11-22T08:00+01:00."
        ) from None
    return instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)
