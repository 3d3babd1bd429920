"""The commands `tada index ...`: the index of how foods look."""

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from app.cli.database import JsonOption, opened_database
from app.core.errors import InvalidInputError
from app.core.settings import Settings

index_cli = typer.Typer(no_args_is_help=True, help="The index of how foods look.")


@index_cli.command("build")
def index_build(
    folder: Annotated[
        Path, typer.Argument(help="FOLDER/<label>/<specimen>/*.jpg; see docs/identification.md.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The index; its labels go beside it as .csv.")
    ] = Path("index.npz"),
    name: Annotated[
        str | None, typer.Option(help="Its name in `index_version`; default: the folder's.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Build an index of how foods look from labelled photographs.

    TADA_FOOD_INDEX makes the server use it.
    """
    from app.candidates.labelled_folder import build_from_folder, labelled_photos
    from app.identification.build_index import write_index, write_labels
    from app.identification.food_index import labels_path, open_index

    if output.suffix != ".npz":
        raise InvalidInputError(f"{output} does not end in .npz.")
    if not output.parent.is_dir():
        raise InvalidInputError(f"{output.parent} is not a folder.")
    for path in (output, labels_path(output)):
        # before minutes of work
        if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
            raise InvalidInputError(f"{path} cannot be written.")
    built = build_from_folder(
        folder,
        name or folder.resolve().name,
        max_pixels=Settings().max_photo_pixels,
        on_photo=_show_progress,
    )
    photographs = len(list(labelled_photos(folder)))
    write_index(output, built)
    write_labels(labels_path(output), built.foods)
    report = {
        "index": str(output),
        "version": open_index(output).version,
        "photographs": photographs,
        "specimens": len(set(built.specimens)),
        "foods": [food.food_key for food in built.foods],
    }
    if as_json:
        print(json.dumps(report))
    else:
        print(
            f"{photographs} photographs, {report['specimens']} specimens, {len(built.foods)} foods: {output}"
        )


def _show_progress(number: int, count: int) -> None:
    """Count on a terminal's standard error."""
    if sys.stderr.isatty():
        print(
            f"\r{number} of {count}",
            end="\n" if number == count else "",
            file=sys.stderr,
            flush=True,
        )


@index_cli.command("rebuild")
def index_rebuild(
    study: Annotated[
        str | None, typer.Option(metavar="CODE", help="Only this study's items.")
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Only count; change nothing.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Compute missing vectors of the current version from items' photographs.

    Safe while workers run.
    """
    from app.children.child_pool import ChildPool
    from app.records.rebuild_index import check_index, rebuild_index
    from app.storage.opening import open_blob_store
    from app.worker import TASKS

    settings = Settings()
    with opened_database() as database:
        if check:
            report = check_index(database, study_code=study)
        else:
            blobs = open_blob_store(settings.resolved_blob_url, settings)
            children = ChildPool(settings, TASKS, children=1)
            try:
                report = rebuild_index(database, blobs, children, settings, study_code=study)
            finally:
                children.close()
    if as_json:
        print(json.dumps(asdict(report)))
    else:
        action = "to describe" if check else "described"
        print(f"{report.described} regions {action}, {report.kept} kept")
        print(
            f"{report.gone} whose photograph is gone, {report.unreadable} unreadable (see the log)"
        )
    raise SystemExit(1 if report.unreadable or (check and report.described) else 0)
