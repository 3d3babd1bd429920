"""The commands `tada index ...`: what the server knows of how foods look."""

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
    """Describe items again that have no vector of the current version, from their photographs. Safe beside workers."""
    from app.children.child_pool import ChildPool
    from app.records.rebuild_index import check_index, rebuild_index
    from app.storage.opening import open_blob_store
    from app.worker import TASKS

    settings = Settings()
    with opened_database() as database:
        if check:
            found = check_index(database, study_code=study)
        else:
            blobs = open_blob_store(settings.resolved_blob_url, settings)
            children = ChildPool(settings, TASKS, children=1)
            try:
                found = rebuild_index(database, blobs, children, settings, study_code=study)
            finally:
                children.close()
    if as_json:
        print(json.dumps(asdict(found)))
    else:
        done = "to describe" if check else "described"
        print(f"{found.described} regions {done}, {found.kept} kept")
        print(f"{found.gone} whose photograph is gone, {found.unreadable} unreadable (see the log)")
    raise SystemExit(1 if found.unreadable or (check and found.described) else 0)
