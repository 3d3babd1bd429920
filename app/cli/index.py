"""The commands `tada index ...`: the index of how foods look."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from app.cli.database import JsonOption, opened_database
from app.core.settings import Settings

index_cli = typer.Typer(no_args_is_help=True, help="The index of how foods look.")


@index_cli.command("rebuild")
def index_rebuild(
    study: Annotated[str | None, typer.Option(metavar="CODE", help="Only this study's items.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Only count; change nothing.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Compute missing vectors of the current version from items' photographs. Safe while workers run."""
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
        print(f"{report.gone} whose photograph is gone, {report.unreadable} unreadable (see the log)")
    raise SystemExit(1 if report.unreadable or (check and report.described) else 0)
