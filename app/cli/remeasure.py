"""The command `tada remeasure`: start or continue remeasurements, show their progress, stop them on Ctrl-C."""

import json
import sys
import time
import uuid
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.database import JsonOption, author, opened_database
from app.core.errors import ConflictError, NotFoundError

if TYPE_CHECKING:
    from app.db.session import Database
    from app.records.remeasurements.schemas import ComparedItemOut, RemeasurementOut, Selection

LOOK_SECONDS = 0.5
LINE_SECONDS = 10.0  # between two lines of progress, where they cannot be overwritten
Works = dict[str, uuid.UUID]  # study's code -> its remeasurement


def remeasure(
    targets: Annotated[
        list[str], typer.Argument(metavar="STUDY|MEAL...", help="Studies' codes, or ids of meals.")
    ],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only list what would be measured, and why not.")
    ] = False,
    limit: Annotated[
        int | None,
        typer.Option(
            min=1, max=2**31 - 1, help="Only so many meals of each study, the first eaten."
        ),
    ] = None,
    wait: Annotated[
        bool, typer.Option(help="Show the progress until it is done; Ctrl-C stops it.")
    ] = True,
    participant: Annotated[
        str | None,
        typer.Option(metavar="CODE", help="The participant, if a meal's id is not unique."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure kept photographs again by today's pipeline, while no meal waits.

    The same command continues it.

    Workers do it. What people said stays on top, and releases stay as they are. Status 1: it was
    stopped.
    """
    with opened_database() as database:
        selections = _selections(database, targets, participant, limit)
        if dry_run:
            _print_plan(database, selections, as_json=as_json)
            return
        works = _start(database, selections)
        if not wait:
            _print_views(_read(database, works), as_json=as_json)
            return
        try:
            _follow(database, works)
        except KeyboardInterrupt:
            _stop(database, works)
            print("Stopped. The same command continues it.", file=sys.stderr)
        views = _read(database, works)
        _print_views(
            views,
            as_json=as_json,
            rows={study: list(_rows(database, study, works)) for study in works},
        )
    raise SystemExit(0 if all(view.state == "done" for view in views.values()) else 1)


def _selections(
    database: "Database", targets: list[str], participant: str | None, limit: int | None
) -> dict[str, "Selection"]:
    """Return study's code -> what is to be measured in it.

    Raises NotFoundError, ConflictError (`meal_id_ambiguous`).
    """
    from app.meals.stored import queries as meals
    from app.records.remeasurements.schemas import Selection

    chosen: dict[str, set[uuid.UUID]] = {}
    whole: set[str] = set()
    for target in targets:
        meal = _meal_id(target)
        if meal is None:
            whole.add(target)
            continue
        with database.read() as session:
            matches = meals.find_meals(
                session, meal, participant_id=None, participant_code=participant, study_ids=None
            )
        if not matches:
            raise NotFoundError(f"There is no meal {meal}.")
        if len(matches) > 1:
            raise ConflictError(
                "More than one participant has a meal of this id: add --participant CODE.",
                code="meal_id_ambiguous",
            )
        chosen.setdefault(matches[0][2], set()).add(meal)
    named = {
        study: Selection(frozenset(ids), limit)
        for study, ids in chosen.items()
        if study not in whole
    }
    return {study: Selection(limit=limit) for study in sorted(whole)} | named


def _meal_id(target: str) -> uuid.UUID | None:
    try:
        return uuid.UUID(target)
    except ValueError:
        return None


def _print_plan(
    database: "Database", selections: Mapping[str, "Selection"], *, as_json: bool
) -> None:
    from app.records.remeasurements.remeasurements import Requester, count_plan, plan_remeasurement

    documents = []
    for study, selection in selections.items():
        pairs = plan_remeasurement(database, Requester(author()), study, selection)
        numbers = count_plan(pairs)
        if as_json:
            rows = [
                {
                    "participant": pair.participant,
                    "meal": str(pair.meal),
                    "pair": pair.pair,
                    "skip": pair.skip,
                }
                for pair in pairs
            ]
            documents.append({"study": study, **numbers.model_dump(), "rows": rows})
            continue
        for pair in pairs:
            print(
                f"{study}/{pair.participant}  {pair.meal}  {pair.pair:5}  {pair.skip or 'would be measured'}"
            )
        print(f"{study}: {numbers.would_measure} of {numbers.pairs} pairs would be measured")
    if as_json:
        print(json.dumps(documents))


def _start(database: "Database", selections: Mapping[str, "Selection"]) -> Works:
    from app.records.remeasurements.remeasurements import Requester, start_remeasurement

    works = {}
    for study, selection in selections.items():
        view, is_new = start_remeasurement(database, Requester(author()), study, selection)
        works[study] = view.id
        if not is_new:
            print(
                f"{study}: continued, {view.waiting} of {view.pairs} pairs left",
                file=sys.stderr,
            )
    return works


def _stop(database: "Database", works: Works) -> None:
    from app.records.remeasurements.remeasurements import Requester, stop_remeasurement

    for study, remeasurement_id in works.items():
        try:
            stop_remeasurement(database, Requester(author()), study, remeasurement_id)
        except ConflictError as error:
            if error.code != "remeasurement_done":
                raise


def _read(database: "Database", works: Works) -> dict[str, "RemeasurementOut"]:
    from app.records.remeasurements.remeasurements import Requester, read_remeasurement

    return {
        study: read_remeasurement(database, Requester(author()), study, each)
        for study, each in works.items()
    }


def _follow(database: "Database", works: Works) -> None:
    """Show the progress until nothing is running any more."""
    shown_at, shown = 0.0, ""
    while True:
        views = _read(database, works)
        is_running = any(view.state == "running" for view in views.values())
        line = "  ".join(f"{study}: {_progress(view)}" for study, view in views.items())
        if is_running and not _has_worker(database):
            line += "  (no worker is running: start `tada worker`)"
        if sys.stderr.isatty():
            print(f"\r{line.ljust(len(shown))}", end="", file=sys.stderr, flush=True)
        elif line != shown and (time.monotonic() - shown_at > LINE_SECONDS or not is_running):
            print(line, file=sys.stderr, flush=True)
            shown_at = time.monotonic()
        shown = line
        if not is_running:
            break
        time.sleep(LOOK_SECONDS)
    if sys.stderr.isatty():
        print(file=sys.stderr)


def _progress(view: "RemeasurementOut") -> str:
    states = f"{view.measured} measured, {view.kept} kept, {view.skipped} skipped"
    return f"{view.pairs - view.waiting} of {view.pairs} pairs ({states})"


def _has_worker(database: "Database") -> bool:
    from app.jobs.leases import living_workers

    return bool(living_workers(database))


def _rows(database: "Database", study: str, works: Works) -> Iterator["ComparedItemOut"]:
    from app.http.paging import all_rows
    from app.records.remeasurements.remeasurements import Requester, list_compared

    return all_rows(
        lambda cursor: list_compared(
            database, Requester(author()), study, works[study], cursor=cursor, limit=1000
        )
    )


def _print_views(
    views: Mapping[str, "RemeasurementOut"],
    *,
    as_json: bool,
    rows: Mapping[str, list["ComparedItemOut"]] | None = None,
) -> None:
    documents = []
    for study, view in views.items():
        table = rows[study] if rows is not None else []
        if as_json:
            items = [row.model_dump(mode="json") for row in table]
            documents.append({"study": study, **view.model_dump(mode="json"), "rows": items})
            continue
        for row in table:
            print(_line(row))
        reasons = "".join(f", {count} {reason}" for reason, count in view.reasons.items())
        differ = f"{view.items_changed} of {view.items} items differ"
        print(f"{study}: {view.state}, {_progress(view)}{reasons}; {differ}")
    if as_json:
        print(json.dumps(documents))


def _line(row: "ComparedItemOut") -> str:
    who = f"{row.participant}  {row.meal_id}  {row.pair:5}"
    if row.item_id is None:
        return f"{who}  {row.state}{f': {row.reason}' if row.reason is not None else ''}"
    old = _volume(row.old_volume_ml, row.old_low_ml, row.old_high_ml)
    new = _volume(row.new_volume_ml, row.new_low_ml, row.new_high_ml)
    return f"{who}  {row.food or '-':24}  {old} -> {new} ml  {_grams(row.old_mass_g)} -> {_grams(row.new_mass_g)} g"


def _volume(volume_ml: float | None, low_ml: float | None, high_ml: float | None) -> str:
    return "-" if volume_ml is None else f"{volume_ml:.1f} [{low_ml:.1f}, {high_ml:.1f}]"


def _grams(mass_g: float | None) -> str:
    return "-" if mass_g is None else f"{mass_g:.1f}"
